"""Delay-and-sum, MUSIC, OMP, IAA, SPICE and LIKES against their papers: exact cases, axes, false alarms."""

from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, U, echoes, half_wavelength_line, noise, some_rows

from trainer.estimators.adaptive import FLOOR, IterativeAdaptive, SparseCovariance
from trainer.estimators.array import LineArray, scan_axis, uniform_axis
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS
from trainer.estimators.baselines import DelayAndSum, aic_count, pseudo_spectrum
from trainer.estimators.omp import FALSE_ALARM, OrthogonalMatchingPursuit, largest_share_of_noise
from trainer.metrics.peaks import strongest_peaks


def test_windows_trade_sidelobes_for_width() -> None:
    array = ARRAYS["full"]
    snapshot = echoes(array, np.zeros((1, 1)), np.ones((1, 1), dtype=complex))
    u = np.linspace(-0.85, 0.85, 4001)
    highest = []
    for window in ("none", "hann", "hamming"):
        level = 20.0 * np.log10(np.maximum(DelayAndSum(window).image(snapshot, array, u, 0.0)[0], 1e-12))
        highest.append(level[np.abs(u) > 3.0 * array.resolution_cell].max())
    assert highest[0] > -22.0
    assert highest[1] < -40.0
    assert -46.0 < highest[2] < -40.0


def slow_covariance_methods(
    x: NDArray[np.complex128], array: LineArray, scan: NDArray[np.float64], noise_power: float, method: str, steps: int
) -> NDArray[np.float64]:
    """One snapshot, one angle at a time, straight from the papers."""
    manifold = array.manifold(scan)
    power = np.array([abs(np.vdot(a, x)) ** 2 for a in manifold.T]) / array.channels**2
    shown = np.sqrt(power)
    for _ in range(steps):
        covariance = sum(p * np.outer(a, a.conj()) for p, a in zip(power, manifold.T, strict=True))
        load = FLOOR * covariance[0, 0].real if method == "iaa" else noise_power
        inverse = np.linalg.inv(covariance + load * np.eye(array.channels))
        filtered = np.array([abs(np.vdot(a, inverse @ x)) for a in manifold.T])
        form = np.array([np.vdot(a, inverse @ a).real for a in manifold.T])
        if method == "iaa":
            shown = filtered / form
            power = shown**2
        else:
            weight = {
                "likes": filtered / form,
                "likes of the paper": 1.0 / np.sqrt(form),
                "spice": np.linalg.norm(x) / np.sqrt(array.channels),
            }[method]
            shown, power = power * filtered, power * filtered * weight
    return shown


@pytest.mark.parametrize("method", ["iaa", "spice", "likes"])
def test_covariance_methods_follow_their_papers(method: str) -> None:
    array, u = ARRAYS["sparse4"], U[::9]
    rows = some_rows(array, rows=2)
    estimator = IterativeAdaptive() if method == "iaa" else SparseCovariance(reweighted=method == "likes")
    estimator.iterations = 4
    image = estimator.image(rows, array, u, 1e-3)
    scan, shown = scan_axis(array, u)
    for row, snapshot in zip(image, rows, strict=True):
        expected = slow_covariance_methods(snapshot, array, scan, 1e-3, method, 4)[shown]
        np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-7)


def test_the_square_of_the_paper_s_step_ends_where_the_paper_s_does() -> None:
    array, u = ARRAYS["sparse4"], U[::9]
    snapshot = echoes(array, u[[[17, 30]]], np.array([[1.0, 0.6j]]))
    snapshot += noise(array, 1, 1e-2, np.random.default_rng(3))
    estimator = SparseCovariance(reweighted=True)
    estimator.iterations = 100
    scan, shown = scan_axis(array, u)
    expected = slow_covariance_methods(snapshot[0], array, scan, 1e-2, "likes of the paper", 300)[shown]
    found = estimator.image(snapshot, array, u, 1e-2)[0]
    assert expected.max() > 0.9
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())
    start = slow_covariance_methods(snapshot[0], array, scan, 1e-2, "likes of the paper", 2)[shown]
    assert np.abs(start - expected).max() > 0.1 * expected.max()


@pytest.mark.parametrize("method", ["iaa", "likes", "spice"])
def test_a_target_beyond_the_axis_is_not_drawn_inside_it(method: str) -> None:
    array = ARRAYS["sparse6"]
    snapshot = echoes(array, np.array([[0.93, -0.2]]), np.array([[1.0, 0.1 + 0.0j]]))
    snapshot += noise(array, 1, 1e-5, np.random.default_rng(0))
    image = ESTIMATORS[method]().image(snapshot, array, U, 1e-5)[0]
    away = np.abs(U + 0.2) > array.resolution_cell
    assert image[away].max() < 0.3 * image[~away].max()


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


def test_omp_finds_separate_targets_exactly() -> None:
    array = ARRAYS["full"]
    bins = np.array([100, 225, 340])
    strengths = np.array([1.0, 0.5j, -0.2])
    snapshot = echoes(array, U[None, bins], strengths[None])
    image = OrthogonalMatchingPursuit().image(snapshot, array, U, 1e-12)[0]
    np.testing.assert_array_equal(np.flatnonzero(image), bins)
    np.testing.assert_allclose(image[bins], np.abs(strengths), rtol=1e-6)


def test_newtonised_omp_leaves_the_grid() -> None:
    array = ARRAYS["full"]
    u = U[[100, 225, 340]] + 0.4 * (U[1] - U[0])
    strengths = np.array([1.0, 0.5j, -0.2])
    snapshot = echoes(array, u[None], strengths[None]) + noise(array, 1, 1e-10, np.random.default_rng(3))
    image = OrthogonalMatchingPursuit("cfar").image(snapshot, array, U, 0.0)[0]
    np.testing.assert_array_equal(np.flatnonzero(image), [100, 225, 340])
    np.testing.assert_allclose(image[[100, 225, 340]], np.abs(strengths), rtol=1e-4)


@pytest.mark.parametrize("stop", ["noise", "cfar"])
def test_omp_of_noise_alone_keeps_its_false_alarm_rate(stop: Literal["noise", "cfar"]) -> None:
    rows = 3000
    for array in (ARRAYS["sparse6"], ARRAYS["sparse4"]):
        x = noise(array, rows, 4.0, np.random.default_rng(11))
        share = np.mean(OrthogonalMatchingPursuit(stop).image(x, array, U, 4.0).any(axis=1))
        # Both rules are set to 1 %, of which the axis shows 88 %: five standard deviations either way.
        assert abs(share - 0.0088) < 5.0 * np.sqrt(FALSE_ALARM / rows)


def test_the_cfar_rule_needs_no_noise_power() -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array, noise_power=0.01)
    images = [OrthogonalMatchingPursuit("cfar").image(rows, array, U, power) for power in (0.0, 0.01, 100.0)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])
    assert images[0].any()


def test_largest_share_of_noise_is_reached_as_often_as_said() -> None:
    array = ARRAYS["sparse4"]
    rows = 20_000
    x = noise(array, rows, 1.0, np.random.default_rng(2))
    axis = uniform_axis(array, 12)
    best = np.abs(x @ array.manifold(axis).conj()).max(axis=1) ** 2 / array.channels
    share = np.mean(best / np.sum(np.abs(x) ** 2, axis=1) > largest_share_of_noise(array, array.channels))
    assert abs(share - FALSE_ALARM) < 4.0 * np.sqrt(FALSE_ALARM / rows)
    assert largest_share_of_noise(array, 1) == 1.0
