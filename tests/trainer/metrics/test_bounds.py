"""Cramer-Rao bounds against doatools, against each other, and what MUSIC reaches."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper_arrays import ARRAYS, echoes, half_wavelength_line, noise

from shared.physics.errors import InputError
from trainer.estimators.base import LineArray
from trainer.estimators.music import pseudo_spectrum
from trainer.metrics.bounds import (
    deterministic_bound,
    music_covariance,
    single_source_bound,
    stochastic_bound,
    uncorrelated_bound,
)

VECTORS = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "vectors" / "doatools_vectors.json"


@pytest.fixture(scope="module")
def vectors() -> dict:
    if not VECTORS.is_file():
        pytest.skip("no reference material beside the checkout")
    return json.loads(VECTORS.read_text(encoding="utf-8"))


def in_radians(covariance: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """u = sin(theta), so that d theta = du / cos(theta)."""
    return covariance / np.outer(np.cos(angles), np.cos(angles))


def test_bounds_of_doatools(vectors: dict) -> None:
    # Their manifold turns the other way: their angle theta is ours at -theta.
    angles, line = np.linspace(-np.pi / 3, np.pi / 4, 3), half_wavelength_line(10)
    sources = np.array(vectors["P_re"]) + 1j * np.array(vectors["P_im"])
    u = -np.sin(angles)
    found = in_radians(deterministic_bound(line, u, sources, 1.0, 100), angles)
    np.testing.assert_allclose(found, vectors["crb_det"], rtol=1e-6)
    found = in_radians(stochastic_bound(line, u, sources, 1.0, 100), angles)
    np.testing.assert_allclose(found, vectors["crb_sto"], rtol=1e-6)
    found = in_radians(uncorrelated_bound(line, u, np.array(vectors["p_uncorrelated"]), 1.0, 100), angles)
    np.testing.assert_allclose(found, vectors["crb_stouc"], rtol=1e-6)


def test_music_covariance_of_doatools(vectors: dict) -> None:
    angles = np.linspace(-np.pi / 3, np.pi / 4, 4)
    sources = np.diag(vectors["p_music"]).astype(complex)
    found = in_radians(music_covariance(half_wavelength_line(12), -np.sin(angles), sources, 1.0, 100), angles)
    np.testing.assert_allclose(found, vectors["music_asymptotic_cov"], rtol=1e-6)


def test_music_reaches_its_asymptotic_covariance() -> None:
    line, u, snapshots, trials = half_wavelength_line(10), np.array([-0.3, 0.2]), 200, 150
    generator = np.random.default_rng(8)
    data = []
    for _ in range(trials):
        strengths = (generator.standard_normal((snapshots, 2, 2)) @ np.array([1.0, 1.0j])) * np.sqrt(0.5)
        data.append((echoes(line, np.tile(u, (snapshots, 1)), strengths) + noise(line, snapshots, 1.0, generator)).T)
    expected = np.sqrt(np.diag(music_covariance(line, u, np.eye(2, dtype=complex), 1.0, snapshots)))
    for source in (0, 1):
        axis = u[source] + np.linspace(-8.0, 8.0, 401) * expected[source]
        spectrum = pseudo_spectrum(np.array(data), line.manifold(axis), targets=2)
        rmse = np.sqrt(np.mean((axis[np.argmax(spectrum, axis=1)] - u[source]) ** 2))
        # 150 trials know a standard deviation to 6 %.
        assert rmse == pytest.approx(expected[source], rel=0.2)


def test_one_source_bounds_agree() -> None:
    for array in ARRAYS.values():
        single = single_source_bound(array, 100.0)
        general = deterministic_bound(array, np.array([0.3]), np.array([[1.0]]), 0.01)
        assert general[0, 0] == pytest.approx(single)
    # A filled line of length L has sum (p - mean p)^2 = C L^2 / 12, but for C^-2, and a cell lambda / L.
    full = ARRAYS["full"]
    expected = full.resolution_cell / (2.0 * np.pi) * np.sqrt(6.0 / (48 * 100.0))
    assert np.sqrt(single_source_bound(full, 100.0)) == pytest.approx(expected, rel=1e-3)


@given(st.floats(0.01, 0.3), st.floats(0.0, 6.28), st.floats(1e-3, 1e3))
def test_a_second_target_never_lowers_the_bound(separation: float, phase: float, power: float) -> None:
    array, u = ARRAYS["sparse6"], np.array([0.1, 0.1 + separation])
    amplitudes = np.sqrt(power) * np.array([1.0, np.exp(1j * phase)])
    sources = np.outer(amplitudes, amplitudes.conj())
    both = deterministic_bound(array, u, sources, 0.1 * power)
    alone = single_source_bound(array, 10.0)
    assert np.diag(both).min() >= alone * (1.0 - 1e-9)
    # Only the SNR counts, and where the pair is does not.
    moved = deterministic_bound(array, u - 0.4, sources, 0.1 * power)
    np.testing.assert_allclose(moved, both, rtol=1e-4)
    assert np.linalg.eigvalsh(both).min() > 0.0


def test_uncorrelated_sources_may_outnumber_the_channels() -> None:
    # Four elements of no redundant distance have 13 in their difference coarray: 6 sources and the noise power.
    line = LineArray(0.5 * np.array([0.0, 1.0, 4.0, 6.0]), 1.0)
    u = np.linspace(-0.8, 0.8, 5)
    assert np.isfinite(uncorrelated_bound(line, u, np.ones(5), 0.1, 100)).all()
    with pytest.raises(InputError, match="fewer sources than channels"):
        stochastic_bound(line, u, np.eye(5, dtype=complex), 0.1, 100)
    with pytest.raises(InputError, match="singular Fisher"):
        uncorrelated_bound(line, np.linspace(-0.8, 0.8, 9), np.ones(9), 0.1, 100)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda a: single_source_bound(a, 0.0), "both positive"),
        (lambda a: single_source_bound(LineArray(np.zeros(3), 1.0), 1.0), "both positive"),
        (lambda a: deterministic_bound(a, np.array([0.1, 0.1]), np.ones((2, 2), complex), 1.0), "tell apart"),
        (lambda a: deterministic_bound(a, np.linspace(-0.5, 0.5, 12), np.eye(12, dtype=complex), 1.0), "fewer sources"),
        (lambda a: music_covariance(a, np.array([0.1, 0.2]), np.ones((2, 2), complex), 1.0, 1), "coherent"),
    ],
)
def test_bounds_that_do_not_exist_are_refused(make, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make(ARRAYS["sparse4"])
