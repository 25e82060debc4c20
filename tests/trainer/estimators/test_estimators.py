"""Estimators against slow references, exact cases and what must not break them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import loadmat

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum
from trainer.data.arrays import choose_array
from trainer.estimators import array as array_module
from trainer.estimators.array import check_snapshots, draw_lines, scan_axis, uniform_axis
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS, LineArray, line_array
from trainer.estimators.covariance import FLOOR, Distances
from trainer.estimators.das import DelayAndSum, aperture_window
from trainer.estimators.iaa import IterativeAdaptive
from trainer.estimators.lines import SEPARABLE, bounded_amplitudes, line_amplitudes, refine_lines
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.music import Music, aic_order, forward_backward, pseudo_spectrum
from trainer.estimators.omp import FALSE_ALARM, OrthogonalMatchingPursuit, largest_share_of_noise
from trainer.estimators.spice import SparseCovariance
from trainer.metrics.resolution import resolved, strongest_peaks
from trainer.metrics.scenarios import Pair, draw_pairs, echoes, noise

RADAR = Radar()
U = RADAR.grid.u
ARRAYS = {name: line_array(RADAR, choose_array(name, RADAR).channels(RADAR)) for name in ("full", "sparse6", "sparse4")}
IRREGULAR = LineArray(np.array([0.0, 3.1e-3, 7.7e-3, 9.0e-3, 16.3e-3, 20.0e-3]), RADAR.waveform.wavelength_m)
MEASURED = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "measured" / "two_reflectors"
AMPLITUDE_KEPT = {"spice": 0.6, "likes": 0.99}
"""Share of the amplitude of a lone target that an estimator must show; the others show it all."""


@pytest.fixture(params=ESTIMATORS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def some_rows(array: LineArray, rows: int = 5, targets: int = 3, noise_power: float = 1e-3) -> NDArray[np.complex128]:
    generator = np.random.default_rng(7)
    u = generator.uniform(-0.8, 0.8, (rows, targets))
    amplitudes = np.exp(2j * np.pi * generator.random((rows, targets)))
    return echoes(array, u, amplitudes) + noise(array, rows, noise_power, generator)


# The line of elements ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("array", ARRAYS)
def test_delay_and_sum_is_that_of_the_images(array: str) -> None:
    choice = choose_array(array, RADAR)
    channels = choice.channels(RADAR)
    generator = np.random.default_rng(1)
    matrix = (generator.standard_normal((9, 48)) + 1j * generator.standard_normal((9, 48))).astype(np.complex64)
    expected = np.abs(delay_and_sum(matrix, RADAR, channels))
    image = DelayAndSum().image(matrix[:, channels], line_array(RADAR, channels), U, 0.0)
    np.testing.assert_allclose(image, expected, atol=2e-6)


def test_spacing_period_and_cell_of_the_paper_arrays() -> None:
    wavelength = RADAR.waveform.wavelength_m
    for array in ARRAYS.values():
        assert array.spacing_m == pytest.approx(2e-3)
        assert array.half_period == pytest.approx(wavelength / 4e-3)
        assert array.resolution == pytest.approx(wavelength / 96e-3)
    assert [array.channels for array in ARRAYS.values()] == [48, 18, 12]


def test_a_period_is_where_the_manifold_repeats() -> None:
    for array in ARRAYS.values():
        overlap = np.vdot(array.manifold(0.1), array.manifold(0.1 + 2.0 * array.half_period))
        assert abs(overlap) == pytest.approx(array.channels)
        assert abs(np.vdot(array.manifold(0.1), array.manifold(0.1 + array.half_period))) < 0.9 * array.channels


def test_elements_off_every_grid_have_no_period() -> None:
    assert IRREGULAR.spacing_m is None
    assert IRREGULAR.half_period == 1.0


@given(
    st.lists(st.integers(0, 60), min_size=2, max_size=10, unique=True), st.floats(0.5e-3, 4e-3), st.floats(-0.2, 0.2)
)
def test_elements_on_a_grid_are_found_to_be(steps: list[int], spacing: float, offset: float) -> None:
    # The true spacing is a part of the smallest gap down to the eighth; the divisor of all gaps is what repeats.
    divisor = np.gcd.reduce(np.diff(sorted(steps)))
    smallest = np.diff(sorted(steps)).min()
    if smallest // divisor > 8:
        return
    array = LineArray(offset + spacing * np.array(steps), 3.868e-3)
    assert array.spacing_m == pytest.approx(divisor * spacing, rel=1e-2)


def test_scan_covers_the_period_and_holds_what_is_shown() -> None:
    array = ARRAYS["sparse4"]
    scan, shown = scan_axis(array, U)
    np.testing.assert_allclose(scan[shown], U, atol=1e-12)
    ring = np.sort(np.append(scan, scan.min() + 2.0 * array.half_period))
    assert scan.min() >= -array.half_period - 1e-12
    assert np.diff(ring).max() <= 1.6 * array.resolution / array_module.POINTS_PER_CELL


def test_scan_folds_angles_beyond_the_period() -> None:
    array = ARRAYS["sparse6"]
    beyond = np.array([-0.99, 0.0, 0.99])
    scan, shown = scan_axis(array, beyond)
    overlap = np.sum(array.manifold(scan[shown]).conj() * array.manifold(beyond), axis=0)
    np.testing.assert_allclose(np.abs(overlap), array.channels)
    assert np.abs(scan).max() <= array.half_period + 1e-12


@pytest.mark.parametrize("array", [ARRAYS["sparse6"], IRREGULAR, LineArray(np.array([0.0, 0.0, 2e-3]), 3.9e-3)])
def test_distances_stand_for_the_dense_covariance(array: LineArray) -> None:
    generator = np.random.default_rng(3)
    u = uniform_axis(array, 3)
    power = generator.random((2, len(u)))
    manifold = array.manifold(u)
    distances = Distances(array, u)
    dense = np.einsum("bn,cn,dn->bcd", power, manifold, manifold.conj())
    np.testing.assert_allclose(distances.covariance(power), dense, atol=1e-9 * len(u))
    matrix = generator.standard_normal(dense.shape) + 1j * generator.standard_normal(dense.shape)
    matrix += np.swapaxes(matrix, 1, 2).conj()
    expected = np.einsum("cn,bcd,dn->bn", manifold.conj(), matrix, manifold).real
    np.testing.assert_allclose(distances.quadratic_form(matrix), expected, atol=1e-9)


# Every estimator -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("array", ARRAYS)
def test_a_lone_target_on_the_left_is_seen_there_at_its_amplitude(name: str, array: str) -> None:
    line = ARRAYS[array]
    place, amplitude = 322, 3e-6 * np.exp(0.4j)  # U[322] = 0.366
    snapshot = echoes(line, U[None, place : place + 1], np.array([[amplitude]]))
    estimator = MaximumLikelihood(1) if name == "ml" else ESTIMATORS[name]()
    image = estimator.image(snapshot, line, U, 1e-16)
    assert image.shape == (1, len(U))
    assert estimator.name == name
    assert np.argmax(image[0]) == place
    shown = image[0, place] / abs(amplitude)
    if name in AMPLITUDE_KEPT:
        # The power may share out to the bins beside it.
        assert AMPLITUDE_KEPT[name] < shown <= 1.0 + 1e-6
    else:
        assert shown == pytest.approx(1.0, rel=2e-3)


def test_hard_rows_stay_finite(name: str) -> None:
    array = ARRAYS["sparse4"]
    generator = np.random.default_rng(2)
    crowd = echoes(array, generator.uniform(-0.8, 0.8, (1, 30)), np.ones((1, 30), dtype=complex))
    one_channel = np.zeros((1, 12), dtype=complex)
    one_channel[0, 4] = 1.0
    rows = np.concatenate(
        [np.zeros((1, 12)), np.ones((1, 12)), crowd, one_channel, noise(array, 2, 1.0, generator), some_rows(array, 2)]
    )
    for noise_power in (0.0, 1e-30, 1.0, 1e30):
        image = ESTIMATORS[name]().image(rows, array, U, noise_power)
        assert image.shape == (len(rows), len(U))
        assert np.isfinite(image).all()
        assert (image >= 0.0).all()
        assert not image[0].any()


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_the_image_has_the_unit_of_the_snapshot(name: str, factor: float) -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array)
    image = ESTIMATORS[name]().image(rows, array, U, 1e-3)
    scaled = ESTIMATORS[name]().image(rows * factor, array, U, 1e-3 * factor**2)
    np.testing.assert_allclose(scaled / factor, image, atol=1e-6 * image.max())
    stored = ESTIMATORS[name]().image((rows * factor).astype(np.complex64), array, U, 1e-3 * factor**2)
    assert np.isfinite(stored).all()


def test_any_line_of_elements_will_do(name: str) -> None:
    wavelength = RADAR.waveform.wavelength_m
    lines = [
        IRREGULAR,
        LineArray(np.array([0.0, 0.0, 2e-3, 6e-3]), wavelength),
        LineArray([0.0, 2e-3, 4e-3], wavelength),
    ]
    for array in lines:
        image = ESTIMATORS[name]().image(some_rows(array), array, U, 1e-3)
        assert np.isfinite(image).all()
    alone = LineArray(np.array([1e-3]), wavelength)
    estimator = MaximumLikelihood(1) if name == "ml" else ESTIMATORS[name]()
    assert np.isfinite(estimator.image(np.array([[1.0 + 1.0j]]), alone, U, 1e-3)).all()


def test_rows_do_not_know_each_other(name: str) -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=array_module.ROWS_AT_ONCE + 3)
    rows[5] = 0.0
    image = ESTIMATORS[name]().image(rows, array, U[::5], 1e-3)
    for row in (0, 6, array_module.ROWS_AT_ONCE - 1, array_module.ROWS_AT_ONCE + 2):
        alone = ESTIMATORS[name]().image(rows[row : row + 1], array, U[::5], 1e-3)
        np.testing.assert_allclose(image[row], alone[0], atol=1e-6 * image.max())


def test_no_rows_are_an_empty_image(name: str) -> None:
    array = ARRAYS["sparse4"]
    assert ESTIMATORS[name]().image(np.zeros((0, 12), dtype=complex), array, U, 1.0).shape == (0, len(U))


@pytest.mark.parametrize(
    ("rows", "noise_power", "text"),
    [
        (np.zeros((2, 11)), 0.0, r"snapshots: shape \(2, 11\); expected \[range bins, 12 channels\]"),
        (np.zeros(12), 0.0, "shape"),
        (np.array([np.ones(12), np.full(12, np.nan)]), 0.0, "1 rows not finite, the first is row 1"),
        (np.ones((2, 12)), -1.0, "noise_power: -1.0"),
        (np.ones((2, 12)), np.nan, "noise_power: nan"),
    ],
)
def test_bad_snapshots_are_refused_in_one_line(name: str, rows: NDArray, noise_power: float, text: str) -> None:
    with pytest.raises(InputError, match=text):
        ESTIMATORS[name]().image(rows, ARRAYS["sparse4"], U, noise_power)


@pytest.mark.parametrize(
    "make",
    [
        lambda: DelayAndSum("blackman"), lambda: OrthogonalMatchingPursuit("aic"), lambda: Music("forward"),
        lambda: Music(targets=0), lambda: MaximumLikelihood(0), lambda: LineArray(np.empty(0), 1.0),
        lambda: LineArray(np.array([np.nan]), 1.0), lambda: LineArray(np.zeros(2), 0.0),
        lambda: aperture_window("kaiser", IRREGULAR), lambda: check_snapshots(np.zeros((1, 2)), IRREGULAR),
        lambda: MaximumLikelihood(6).locate(np.ones((1, 6)), IRREGULAR),
        lambda: UNIFORM_ESTIMATORS["music-fbss"]().image(np.ones((1, 12)), ARRAYS["sparse4"], U, 0.0),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make) -> None:
    with pytest.raises(InputError, match="expected"):
        make()


# Delay-and-sum, IAA, SPICE -------------------------------------------------------------------------------------------


def test_windows_trade_sidelobes_for_width() -> None:
    array = ARRAYS["full"]
    snapshot = echoes(array, np.zeros((1, 1)), np.ones((1, 1), dtype=complex))
    u = np.linspace(-0.85, 0.85, 4001)
    highest = []
    for window in ("none", "hann", "hamming"):
        level = 20.0 * np.log10(np.maximum(DelayAndSum(window).image(snapshot, array, u, 0.0)[0], 1e-12))
        highest.append(level[np.abs(u) > 3.0 * array.resolution].max())
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
            weight = 1.0 / np.sqrt(form) if method == "likes" else np.linalg.norm(x) / np.sqrt(array.channels)
            shown, power = power * filtered, power * filtered * weight
    return shown


@pytest.mark.parametrize("method", ["iaa", "spice", "likes"])
def test_covariance_methods_follow_their_papers(method: str) -> None:
    array, u = ARRAYS["sparse4"], U[::9]
    rows = some_rows(array, rows=2)
    estimator = {"iaa": IterativeAdaptive(4), "spice": SparseCovariance(), "likes": SparseCovariance(True)}[method]
    estimator.iterations = 4
    image = estimator.image(rows, array, u, 1e-3)
    scan, shown = scan_axis(array, u)
    for row, snapshot in zip(image, rows, strict=True):
        expected = slow_covariance_methods(snapshot, array, scan, 1e-3, method, 4)[shown]
        np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("method", ["iaa", "likes", "spice"])
def test_a_target_beyond_the_axis_is_not_drawn_inside_it(method: str) -> None:
    array = ARRAYS["sparse6"]
    snapshot = echoes(array, np.array([[0.93, -0.2]]), np.array([[1.0, 0.1 + 0.0j]]))
    snapshot += noise(array, 1, 1e-5, np.random.default_rng(0))
    image = ESTIMATORS[method]().image(snapshot, array, U, 1e-5)[0]
    away = np.abs(U + 0.2) > array.resolution
    assert image[away].max() < 0.3 * image[~away].max()


def test_likes_reaches_below_the_resolution_cell_where_delay_and_sum_does_not() -> None:
    array = ARRAYS["sparse6"]
    trials = draw_pairs(array, Pair(separation=0.5, snr_db=30.0, phase_rad=np.pi / 2), 20, seed=1)
    found = {
        name: strongest_peaks(ESTIMATORS[name]().image(trials.snapshots, array, U, trials.noise_power), U, 2)
        for name in ("likes", "das")
    }
    np.testing.assert_allclose(found["likes"], trials.u, atol=0.15 * array.resolution)
    assert not resolved(found["das"], trials.u).any()


# MUSIC ---------------------------------------------------------------------------------------------------------------


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
        eigenvalues = np.linalg.eigvalsh(data.T @ data.conj() / 200)[None, ::-1]
        # AIC overestimates with some probability that does not vanish; it must not underestimate here.
        assert targets <= aic_order(eigenvalues, 200)[0] <= targets + 2
    rank_one = np.zeros((3, 10))
    rank_one[:2, 0] = [1.0, 1e-30]
    rank_one[1, 1:] = 1e-47  # rounding of an eigenvalue solver
    np.testing.assert_array_equal(aic_order(rank_one, 1), [1, 1, 0])


def test_smoothing_resolves_what_one_snapshot_alone_does_not() -> None:
    array = ARRAYS["full"]
    true = np.array([[-1.0, 1.0]]) * array.resolution
    snapshot = echoes(array, true, np.ones((1, 2), dtype=complex)) + noise(array, 1, 1e-3, np.random.default_rng(1))
    smoothed = UNIFORM_ESTIMATORS["music-fbss"]().image(snapshot, array, U, 1e-3)
    np.testing.assert_allclose(strongest_peaks(smoothed, U, 2), true, atol=0.3 * array.resolution)


def test_smoothed_data_are_those_of_a_subarray() -> None:
    array = LineArray(0.5 * np.arange(8.0), 1.0)
    x = echoes(array, np.array([[0.3]]), np.array([[1.0 + 0.5j]]))
    data = forward_backward(x, 5)
    assert data.shape == (1, 5, 8)
    # One target is one direction, whatever is shifted and mirrored.
    assert np.linalg.matrix_rank(data[0], tol=1e-9) == 1
    steering = LineArray(0.5 * np.arange(5.0), 1.0).manifold(np.array([0.3]))
    assert pseudo_spectrum(data, steering, 1)[0, 0] > 1e6


# OMP -----------------------------------------------------------------------------------------------------------------


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
def test_omp_of_noise_alone_keeps_its_false_alarm_rate(stop: str) -> None:
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


# Maximum likelihood --------------------------------------------------------------------------------------------------


def test_maximum_likelihood_is_exact_without_noise() -> None:
    array = ARRAYS["sparse6"]
    true = np.array([[-0.4, 0.11, 0.153], [-0.7, 0.0, 0.02]])
    strengths = np.array([[1.0, 0.3j, -1.0], [0.5, 1.0j, 1.0]])
    rows = echoes(array, true, strengths)
    found, amplitude = MaximumLikelihood(3).locate(rows, array)
    np.testing.assert_allclose(found, true, atol=1e-6)
    np.testing.assert_allclose(amplitude, strengths, atol=1e-4)
    pair, _ = MaximumLikelihood().locate(echoes(array, true[:, 1:], strengths[:, 1:]), array)
    np.testing.assert_allclose(pair, true[:, 1:], atol=1e-6)


def test_no_pair_explains_more_than_the_maximum_likelihood_pair() -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=30, targets=4, noise_power=0.3)
    found, _ = MaximumLikelihood(2).locate(rows, array)
    left = np.linalg.norm(line_amplitudes(rows, found, array)[1], axis=1)
    generator = np.random.default_rng(0)
    for _ in range(40):
        start = generator.uniform(-array.half_period, array.half_period, (30, 2))
        other = np.linalg.norm(line_amplitudes(rows, refine_lines(rows, start, array), array)[1], axis=1)
        assert (left <= other * (1.0 + 1e-6)).all()


def test_locate_leaves_empty_rows_at_zero() -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=3)
    rows[1] = 0.0
    found, amplitude = MaximumLikelihood().locate(rows, array)
    assert not found[1].any()
    assert not amplitude[1].any()
    assert np.abs(amplitude[[0, 2]]).min() > 0.0
    assert (np.diff(found) >= 0.0).all()


@pytest.mark.parametrize("array", ["full", "sparse6", "sparse4"])
def test_lines_in_noise_do_not_cancel_each_other(array: str) -> None:
    """Two angles told of, none there: unbounded least squares reaches a thousand times the noise."""
    line = ARRAYS[array]
    rows = noise(line, 300, 1.0, np.random.default_rng(0))
    found, amplitude = MaximumLikelihood().locate(rows, line)
    # At most what any unit combination of channels has in it, over the least singular value kept.
    limit = np.linalg.norm(rows, axis=1) / np.sqrt(SEPARABLE * line.channels)
    assert (np.abs(amplitude).max(axis=1) <= limit).all()
    assert np.abs(amplitude).max() < 3.0
    if array == "full":
        assert np.abs(line_amplitudes(rows, found, line)[0]).max() > 100.0


def test_bounded_amplitudes_are_those_of_least_squares_until_lines_all_but_coincide() -> None:
    array = ARRAYS["sparse6"]
    generator = np.random.default_rng(1)
    apart = np.array([[0.1, 0.1 + 0.5 * array.resolution, 0.4]])
    x = echoes(array, apart, np.array([[1.0, 0.5j, -0.2]])) + noise(array, 1, 0.01, generator)
    for bounded, plain in zip(bounded_amplitudes(x, apart, array), line_amplitudes(x, apart, array), strict=True):
        np.testing.assert_allclose(bounded, plain, atol=1e-9)
    # The sum of what stands there, halved; nothing where they cancel.
    close = np.array([[0.1, 0.1 + 1e-4 * array.resolution]])
    same = echoes(array, close, np.array([[0.7, 0.3]]))
    np.testing.assert_allclose(bounded_amplitudes(same, close, array)[0], [[0.5, 0.5]], atol=1e-3)
    opposite = echoes(array, close, np.array([[500.0, -500.0]])) + echoes(array, close[:, :1], np.ones((1, 1)))
    amplitude, left = bounded_amplitudes(opposite, close, array)
    np.testing.assert_allclose(np.abs(amplitude), 0.5, atol=0.2)
    np.testing.assert_allclose(left, opposite - echoes(array, close, amplitude))


def test_refinement_never_makes_it_worse() -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array, rows=40, noise_power=0.1)
    start = np.random.default_rng(1).uniform(-0.9, 0.9, (40, 3))
    start[0] = 0.2  # three lines at one angle
    before = np.linalg.norm(line_amplitudes(rows, start, array)[1], axis=1)
    after = np.linalg.norm(line_amplitudes(rows, refine_lines(rows, start, array), array)[1], axis=1)
    assert (after <= before * (1.0 + 1e-9)).all()
    assert after.mean() < 0.95 * before.mean()


def test_lines_are_drawn_in_their_nearest_bin() -> None:
    array, u = ARRAYS["full"], np.array([-0.2, 0.0, 0.2])
    found = np.array([[-0.31, -0.29, 0.05, 0.11], [0.29, 0.31, -0.05, 0.04]])
    amplitude = np.array([[9.0, 1.0, 2.0, 0.0], [3.0, 9.0, 4.0, 5.0]])
    np.testing.assert_array_equal(draw_lines(found, amplitude, array, u), [[1.0, 2.0, 0.0], [0.0, 5.0, 3.0]])
    assert draw_lines(found[:, :0], amplitude[:, :0], array, u).shape == (2, 3)


# A real snapshot -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def snapshot() -> NDArray[np.complex128]:
    path = MEASURED / "realData_demo.mat"
    if not path.is_file():
        pytest.skip("no reference material beside the checkout")
    # Their phase turns the other way.
    return loadmat(path)["bv_final"].conj()


def half_wavelength_line(elements: int) -> LineArray:
    return LineArray(0.5 * np.arange(float(elements)), 1.0)


def degrees(u: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.rad2deg(np.arcsin(u))


def test_two_real_reflectors(snapshot: NDArray[np.complex128]) -> None:
    u = np.sin(np.deg2rad(np.arange(-60.0, 60.0, 0.02)))
    likelihood, _ = MaximumLikelihood(2).locate(snapshot, half_wavelength_line(86))
    np.testing.assert_allclose(degrees(likelihood), [[-0.006, 6.985]], atol=5e-3)
    das = DelayAndSum().image(snapshot[:, :48], half_wavelength_line(48), u, 0.0)
    np.testing.assert_allclose(degrees(strongest_peaks(das, u, 2)), [[-0.08, 7.00]], atol=0.02)
    few = half_wavelength_line(10)
    das = DelayAndSum().image(snapshot[:, :10], few, u, 0.0)
    assert degrees(strongest_peaks(das, u, 1))[0, 0] == pytest.approx(3.3, abs=0.1)
    smoothed = Music("forward-backward", targets=2).image(snapshot[:, :10], few, u, 0.0)
    np.testing.assert_allclose(degrees(strongest_peaks(smoothed, u, 2)), [[-0.16, 6.68]], atol=0.02)


@pytest.mark.parametrize("name", ["iaa", "spice", "likes", "ml", "omp-cfar"])
def test_ten_elements_are_enough_for_the_serious_ones(name: str, snapshot: NDArray[np.complex128]) -> None:
    u = np.sin(np.deg2rad(np.arange(-60.0, 60.0, 0.05)))
    image = ESTIMATORS[name]().image(snapshot[:, :10], half_wavelength_line(10), u, 1e-6)
    np.testing.assert_allclose(degrees(strongest_peaks(image, u, 2)), [[0.0, 7.0]], atol=1.2)
