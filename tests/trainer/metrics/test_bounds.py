"""Cramer-Rao bounds, and what estimators make of them; probability of resolution against the guide."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.estimators.base import ESTIMATORS, LineArray, line_array
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.music import pseudo_spectrum
from trainer.metrics.bounds import (
    deterministic_bound,
    music_covariance,
    single_source_bound,
    stochastic_bound,
    uncorrelated_bound,
)
from trainer.metrics.resolution import (
    angular_accuracy,
    likelihood_locator,
    peak_locator,
    resolution_table,
    resolved,
    strongest_peaks,
)
from trainer.metrics.scenarios import Pair, Trials, draw_pairs, draw_single, echoes, noise

RADAR = Radar()
ARRAYS = {name: line_array(RADAR, choose_array(name, RADAR).channels(RADAR)) for name in ("full", "sparse6", "sparse4")}
VECTORS = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "vectors" / "doatools_vectors.json"


def half_wavelength_line(elements: int) -> LineArray:
    return LineArray(0.5 * np.arange(float(elements)), 1.0)


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
    expected = full.resolution / (2.0 * np.pi) * np.sqrt(6.0 / (48 * 100.0))
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
        (lambda a: deterministic_bound(a, np.array([0.1, 0.1]), np.ones((2, 2)), 1.0), "tell apart"),
        (lambda a: deterministic_bound(a, np.linspace(-0.5, 0.5, 12), np.eye(12), 1.0), "fewer sources"),
        (lambda a: music_covariance(a, np.array([0.1, 0.2]), np.ones((2, 2)), 1.0, 1), "coherent"),
    ],
)
def test_bounds_that_do_not_exist_are_refused(make, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make(ARRAYS["sparse4"])


# Estimators against the bounds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("array", "snr_db"), [("full", 0.0), ("sparse6", 5.0), ("sparse4", 10.0), ("sparse4", 30.0)])
def test_maximum_likelihood_is_efficient_above_its_threshold(array: str, snr_db: float) -> None:
    line = ARRAYS[array]
    trials = draw_single(line, snr_db, 2000, seed=3)
    accuracy = angular_accuracy(likelihood_locator(1)(trials.snapshots, line, trials.noise_power), trials, line)
    assert accuracy.found == 1.0
    assert 0.95 <= accuracy.ratio <= 1.1
    assert abs(accuracy.bias) < 4.0 * accuracy.rmse / np.sqrt(2000)


def test_below_the_threshold_sidelobes_take_over() -> None:
    line = ARRAYS["sparse4"]
    trials = draw_single(line, 0.0, 500, seed=3)
    found = likelihood_locator(1)(trials.snapshots, line, trials.noise_power)
    assert angular_accuracy(found, trials, line).ratio > 3.0


def test_maximum_likelihood_of_pairs_is_efficient() -> None:
    line = ARRAYS["sparse6"]
    trials = draw_pairs(line, Pair(separation=1.0, snr_db=20.0), 400, seed=5)
    found = likelihood_locator(2)(trials.snapshots, line, trials.noise_power)
    assert 0.9 <= angular_accuracy(found, trials, line).ratio <= 1.1


def test_accuracy_of_a_known_error() -> None:
    line = ARRAYS["sparse6"]
    trials = draw_single(line, 20.0, 50, seed=1)
    found = trials.u + 0.01
    found[7] = np.nan
    accuracy = angular_accuracy(found, trials, line)
    assert accuracy.found == 49 / 50
    assert (accuracy.bias, accuracy.rmse) == (pytest.approx(0.01), pytest.approx(0.01))
    assert accuracy.bound == pytest.approx(np.sqrt(single_source_bound(line, 100.0)))
    with pytest.raises(InputError, match="no trial"):
        angular_accuracy(np.full_like(found, np.nan), trials, line)
    with pytest.raises(InputError, match="shape"):
        angular_accuracy(found[:3], trials, line)


GUIDE = {
    ("sparse6", 1.0, "das"): (0.61, 0.68, 0.73),
    ("sparse6", 0.5, "das"): (0.07, 0.08, 0.12),
    ("sparse6", 0.5, "iaa"): (0.56, 0.81, 1.0),
    ("sparse6", 0.5, "ml"): (0.84, 0.99, 1.0),
    ("sparse6", 0.25, "ml"): (0.26, 0.78, 0.97),
    ("sparse4", 1.0, "iaa"): (0.69, 0.94, 1.0),
    ("sparse4", 0.5, "iaa"): (0.28, 0.58, 0.83),
    ("sparse4", 0.5, "ml"): (0.73, 0.97, 1.0),
    ("sparse4", 0.25, "das"): (0.0, 0.0, 0.0),
}
"""P(resolve) of the project's facts at 10, 20 and 30 dB, from 200 trials: a standard error of up to 0.035."""


@pytest.mark.parametrize(("array", "separation", "method"), GUIDE)
def test_probability_of_resolution_is_that_of_the_guide(array: str, separation: float, method: str) -> None:
    locate = likelihood_locator(2) if method == "ml" else peak_locator(ESTIMATORS[method](), RADAR.grid.u)
    cells = list(
        resolution_table({method: locate}, {array: ARRAYS[array]}, separations=(separation,), trials=100, seed=0)
    )
    for cell, expected in zip(cells, GUIDE[array, separation, method], strict=True):
        # 0.08, or the Wilson intervals of this test's 100 trials and the guide's standard error.
        assert cell.probability.low - 0.08 <= expected <= cell.probability.high + 0.08
        assert cell.trials == 100
        assert cell.pair.separation == separation


def test_a_resolution_table_has_every_cell_once() -> None:
    methods = {
        "das": peak_locator(ESTIMATORS["das"](), RADAR.grid.u),
        "truth": lambda x, a, n: np.full((len(x), 2), np.nan),
    }
    cells = list(
        resolution_table(
            methods, {name: ARRAYS[name] for name in ("sparse6", "sparse4")}, separations=(3.0, 0.2), snrs_db=(20.0,),
            ratios_db=(0.0, -6.0), phases_rad=(0.0, np.pi, None), trials=10,
        )
    )  # fmt: skip
    assert len({(c.method, c.array, c.pair) for c in cells}) == len(cells) == 2 * 2 * 2 * 2 * 3
    # Who finds nothing resolves nothing.
    assert all(cell.probability.value == 0.0 for cell in cells if cell.method == "truth")
    assert any(cell.probability.value > 0.5 for cell in cells if cell.method == "das")


def test_a_perfect_locator_resolves_and_an_empty_image_does_not() -> None:
    trials = draw_pairs(ARRAYS["sparse6"], Pair(0.5, 20.0), 30, seed=2)
    assert resolved(trials.u, trials.u).all()
    u = RADAR.grid.u
    assert not resolved(strongest_peaks(np.zeros((30, len(u))), u, 2), trials.u).any()
    one = np.column_stack([trials.u[:, 0], np.full(30, np.nan)])
    assert not resolved(one, trials.u).any()
    # A single peak in the middle is not two.
    assert not resolved(np.repeat(trials.u.mean(axis=1, keepdims=True), 2, axis=1), trials.u).any()


def test_random_angles_resolve_as_often_as_chance_says() -> None:
    separation = 0.4
    trials = 4000
    true = np.tile([[-separation / 2, separation / 2]], (trials, 1))
    found = np.sort(np.random.default_rng(0).uniform(-1.0, 1.0, (trials, 2)), axis=1)
    # Each angle must fall in its half of an interval of twice the separation: 2 (s / 2)^2.
    expected = 2.0 * (separation / 2.0) ** 2
    assert np.mean(resolved(found, true)) == pytest.approx(expected, abs=4.0 * np.sqrt(expected / trials))


def test_pairs_are_what_they_say() -> None:
    array = ARRAYS["full"]
    pair = Pair(separation=2.0, snr_db=10.0, ratio_db=-6.0, phase_rad=np.pi / 3)
    trials = draw_pairs(array, pair, 500, seed=9)
    np.testing.assert_allclose(np.diff(trials.u, axis=1), 2.0 * array.resolution)
    middle = 0.5 * (array.positions_m.min() + array.positions_m.max())
    at_centre = trials.amplitudes * np.exp(-2j * np.pi / array.wavelength_m * middle * trials.u)
    np.testing.assert_allclose(
        at_centre[:, 1] / at_centre[:, 0] / np.abs(at_centre[:, 1] / at_centre[:, 0]), np.exp(1j * np.pi / 3)
    )
    assert np.abs(trials.amplitudes).max(axis=1) == pytest.approx(1.0)
    assert np.abs(trials.amplitudes).min(axis=1) == pytest.approx(10 ** (-0.3))
    left = trials.snapshots - echoes(array, trials.u, trials.amplitudes)
    assert np.mean(np.abs(left) ** 2) == pytest.approx(0.1, rel=0.05)
    again = draw_pairs(array, pair, 500, seed=9)
    np.testing.assert_array_equal(trials.snapshots, again.snapshots)
    np.testing.assert_array_equal(trials.u, draw_pairs(ARRAYS["sparse4"], pair, 500, seed=9).u)


@pytest.mark.parametrize(
    "pair", [{"separation": 0.0, "snr_db": 10.0}, {"separation": 1.0, "snr_db": 1.0, "ratio_db": 3.0}]
)
def test_impossible_pairs_are_refused(pair: dict) -> None:
    with pytest.raises(InputError, match="pair"):
        Pair(**pair)


def test_resolved_refuses_other_shapes() -> None:
    with pytest.raises(InputError, match="shapes"):
        resolved(np.zeros((3, 2)), np.zeros((3, 3)))


def test_trials_of_one_target_know_the_likelihood_estimate() -> None:
    line = ARRAYS["full"]
    trials: Trials = draw_single(line, 60.0, 5, seed=0)
    found, amplitude = MaximumLikelihood(1).locate(trials.snapshots, line)
    np.testing.assert_allclose(found, trials.u, atol=1e-4)
    np.testing.assert_allclose(np.abs(amplitude), 1.0, atol=1e-3)
