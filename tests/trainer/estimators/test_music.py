"""MUSIC: what one snapshot allows, and what smoothing brings."""

from __future__ import annotations

import numpy as np
import pytest
from paper_arrays import ARRAYS, U, echoes, half_wavelength_line, noise, some_rows

from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS
from trainer.estimators.baselines import aic_count, pseudo_spectrum
from trainer.metrics.peaks import strongest_peaks


def test_the_papers_music_is_a_rising_function_of_delay_and_sum() -> None:
    for array in ARRAYS.values():
        rows = some_rows(array, noise_power=0.1)
        das, music = (ESTIMATORS[name]().image(rows, array, U, 0.1) for name in ("das", "music"))
        for beam, spectrum in zip(das, music, strict=True):
            order = np.argsort(beam)
            assert (np.diff(spectrum[order]) >= -1e-12 * spectrum.max()).all()
        np.testing.assert_allclose(music.max(axis=1), das.max(axis=1))


def test_aic_counts_targets_with_snapshots_and_one_without() -> None:
    array = LineArray(0.5 * np.arange(10.0), 1.0)
    generator = np.random.default_rng(5)
    for targets in (1, 2, 3):
        u = np.array([[-0.5, 0.1, 0.6]])[:, :targets]
        strengths = generator.standard_normal((200, targets)) + 1j * generator.standard_normal((200, targets))
        data = echoes(array, np.repeat(u, 200, axis=0), strengths) + noise(array, 200, 0.01, generator)
        eigenvalues = np.linalg.eigvalsh(data.T @ data.conj() / 200)[None, ::-1].astype(np.float64)
        # AIC overestimates with some probability that does not vanish; it must not underestimate here.
        assert targets <= aic_count(eigenvalues, 200)[0] <= targets + 2
    rank_one = np.zeros((3, 10))
    rank_one[:2, 0] = [1.0, 1e-30]
    rank_one[1, 1:] = 1e-47  # rounding of an eigenvalue solver
    np.testing.assert_array_equal(aic_count(rank_one, 1), [1, 1, 0])


def test_smoothing_resolves_what_one_snapshot_alone_does_not() -> None:
    array = ARRAYS["full"]
    true = np.array([[-1.0, 1.0]]) * array.resolution_cell
    snapshot = echoes(array, true, np.ones((1, 2), dtype=complex)) + noise(array, 1, 1e-3, np.random.default_rng(1))
    smoothed = UNIFORM_ESTIMATORS["music-fbss"]().image(snapshot, array, U, 1e-3)
    np.testing.assert_allclose(strongest_peaks(smoothed, U, 2), true, atol=0.3 * array.resolution_cell)


def test_music_reaches_its_asymptotic_covariance() -> None:
    line, u, snapshots, trials = half_wavelength_line(10), np.array([-0.3, 0.2]), 200, 150
    generator = np.random.default_rng(8)
    data = []
    for _ in range(trials):
        strengths = (generator.standard_normal((snapshots, 2, 2)) @ np.array([1.0, 1.0j])) * np.sqrt(0.5)
        data.append((echoes(line, np.tile(u, (snapshots, 1)), strengths) + noise(line, snapshots, 1.0, generator)).T)
    # Eq. (3.12) of Stoica and Nehorai 1989 for sources of power 1 in noise of power 1: 5 % above the Cramer-Rao bound.
    expected = 1.840e-3
    for source in (0, 1):
        axis = u[source] + np.linspace(-8.0, 8.0, 401) * expected
        spectrum = pseudo_spectrum(np.array(data), line.manifold(axis), targets=2)
        rmse = np.sqrt(np.mean((axis[np.argmax(spectrum, axis=1)] - u[source]) ** 2))
        # 150 trials know a standard deviation to 6 %.
        assert rmse == pytest.approx(expected, rel=0.2)
