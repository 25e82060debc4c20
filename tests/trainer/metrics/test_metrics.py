"""Every metric: a perfect image, an empty one, white noise, and a slow reference."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.signal import find_peaks
from torchmetrics.functional.image import structural_similarity_index_measure

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.windows import angle_window
from shared.signal.windows import point_spread as window_point_spread
from trainer.data.arrays import choose_array
from trainer.estimators.base import ESTIMATORS, LineArray, line_array
from trainer.metrics.bootstrap import bootstrap_mean, bootstrap_ratio, wilson
from trainer.metrics.detection import (
    PROMINENCES,
    TRUTH_PROMINENCE,
    Counts,
    count_one_to_one,
    find_image_peaks,
    find_row_peaks,
    half_separation,
    match,
    paper_sweep,
    strict_counts,
    total,
)
from trainer.metrics.gospa import gospa
from trainer.metrics.image import level_image, nmse, nmse_best_scaled, psnr, ssim
from trainer.metrics.noise_only import false_alarms, noise_level
from trainer.metrics.scenarios import echoes, noise
from trainer.metrics.width import point_spread

RADAR = Radar()
U = RADAR.grid.u
BINS = len(U)
ARRAYS = {name: line_array(RADAR, choose_array(name, RADAR).channels(RADAR)) for name in ("full", "sparse6", "sparse4")}


def lines_image(places: list[list[int]], width: float = 1.0) -> NDArray[np.float64]:
    """[rows, 450] images of Gaussian lines of equal height."""
    bins = np.arange(BINS)
    return np.array([sum((np.exp(-0.5 * ((bins - p) / width) ** 2) for p in row), np.zeros(BINS)) for row in places])


TRUTH = lines_image([[100, 200], [], [50], [300, 310, 400]])


def sweep(
    estimate: NDArray, truth: NDArray, prominences: tuple[float, ...], d_max: int = 2, threshold: float = 0.5
) -> list[Counts]:
    """The paper's counts of an image; the truth's peaks are found in the same way, those that stand out."""
    true = find_image_peaks(truth).above(TRUTH_PROMINENCE)
    return paper_sweep(find_image_peaks(estimate, threshold), true, prominences, d_max)


def strict(estimate: NDArray, truth: NDArray, d_max: float = 2) -> Counts:
    return strict_counts(find_image_peaks(estimate).above(0.05), find_image_peaks(truth).above(0.05), d_max)


# Detection -----------------------------------------------------------------------------------------------------------


def test_a_perfect_image_detects_all_and_nothing_else() -> None:
    for counts in (*sweep(TRUTH, TRUTH, (0.0, 0.3)), strict(TRUTH, TRUTH)):
        assert (counts.tp, counts.fp, counts.fn) == (6, 0, 0)
        assert counts.detection_rate == counts.precision == counts.f1 == 1.0
        assert counts.false_alarm_rate == 0.0


def test_an_empty_image_scores_zero() -> None:
    for counts in (*sweep(np.zeros_like(TRUTH), TRUTH, (0.0,)), strict(np.zeros_like(TRUTH), TRUTH)):
        assert (counts.tp, counts.fp, counts.fn) == (0, 0, 6)
        assert counts.detection_rate == counts.precision == counts.f1 == counts.false_alarm_rate == 0.0


@pytest.mark.parametrize("d_max", [2, 4])
def test_white_noise_is_detected_by_chance(d_max: int) -> None:
    # Of n values in any order 2^(n - 1) of n! orders have no inner maximum: a window of 2 d_max + 1 bins and its two
    # neighbours holds a peak otherwise. One bin in three is a peak of at least t where it is the largest of three
    # uniform numbers and above t: (1 - t^3) / 3.
    rows = 2000
    generator = np.random.default_rng(6)
    image = generator.random((rows, BINS))
    image[:, 0] = 1.0  # no peak itself; the maximum of every row, so that the threshold is that of the numbers
    truth = lines_image([[p] for p in generator.integers(50, 400, rows)])
    window = 2 * d_max + 3
    expected = 1.0 - 2.0 ** (window - 1) / np.prod(np.arange(1.0, window + 1))
    counts = sweep(image, truth, (0.0,), d_max, threshold=0.0)[0]
    assert counts.detection_rate == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / rows) + 1e-3)
    cut = sweep(image, truth, (0.0,), d_max, threshold=0.5)[0]
    # The outermost bins are no peaks, and bin 1 has the forced maximum beside it.
    assert (cut.tp + cut.fp) / rows == pytest.approx((BINS - 3) * (1.0 - 0.5**3) / 3.0, rel=0.01)
    assert cut.precision == pytest.approx((2 * d_max + 1) / (BINS - 3), rel=0.1)
    # Of all bins but those near the truth.
    assert cut.false_alarm_rate == pytest.approx(7 / 24 * (1.0 - (2 * d_max + 1) / BINS), rel=0.01)


def count_as_the_paper(detected: NDArray, true: NDArray, d_max: float, bins: int) -> Counts:
    """The rules of the paper, section IV-C, for one row, each from the distances of all pairs."""
    near = np.abs(np.subtract.outer(detected, true)) <= d_max
    hits = int(near.any(axis=1).sum())
    occupied = len(np.union1d(detected, true))
    return Counts(hits, len(detected) - hits, len(true) - int(near.any(axis=0).sum()), bins - occupied)


def test_the_papers_rules_by_hand() -> None:
    true = np.array([10, 13, 100])
    # 11 serves both 10 and 13; 12 is a second detection of them; 104 is beyond 2; 101 and 200.
    counts = count_as_the_paper(np.array([11, 12, 104, 200]), true, 2, 450)
    assert counts == Counts(tp=2, fp=2, fn=1, tn=450 - 7)
    assert count_as_the_paper(np.array([11, 12, 104, 200]), true, 4, 450) == Counts(tp=3, fp=1, fn=0, tn=450 - 7)
    assert count_as_the_paper(np.array([10]), true, 0, 450) == Counts(tp=1, fp=0, fn=2, tn=447)
    assert count_as_the_paper(np.array([], dtype=int), true, 2, 450).detection_rate == 0.0
    one = count_as_the_paper(np.array([11]), np.array([10, 12]), 2, 450)
    assert (one.tp, one.fn) == (1, 0)
    assert count_one_to_one(np.array([11.0]), np.array([10.0, 12.0]), 2.0) == Counts(tp=0, fp=1, fn=2)


def crowded_images() -> tuple[NDArray, NDArray]:
    """(estimate, truth) of smooth noise, with plateaus, empty rows, and peaks beside both ends of a row."""
    generator = np.random.default_rng(4)
    estimate, truth = (np.apply_along_axis(np.convolve, 1, generator.random((60, 52)), np.hanning(n), mode="valid")
                       for n in (5, 6))  # fmt: skip
    estimate, truth = estimate[:, :47], np.round(truth[:, :47], 1)
    estimate[3], truth[7], estimate[8], truth[8] = 0.0, 0.0, 1.0, 1.0
    estimate[9, [1, -2]] = truth[9, [1, -2]] = 9.0
    return estimate, truth


def test_peaks_of_an_image_are_those_of_its_rows() -> None:
    for image in crowded_images():
        peaks = find_image_peaks(image)
        rows = [find_row_peaks(row) for row in image]
        for found, row in zip(peaks.by_row(), rows, strict=True):
            np.testing.assert_array_equal(found, row.bins)
        np.testing.assert_array_equal(peaks.prominence, np.concatenate([row.prominence for row in rows]))
    assert [len(bins) for bins in find_image_peaks(np.zeros((3, 9))).by_row()] == [0, 0, 0]


@pytest.mark.parametrize("d_max", [0, 2, 4])
def test_a_sweep_over_an_image_is_the_rules_row_by_row(d_max: int) -> None:
    estimate, truth = crowded_images()
    for prominence, counts in zip(PROMINENCES, sweep(estimate, truth, PROMINENCES, d_max), strict=True):
        expected = Counts()
        for row, true_row in zip(estimate, truth, strict=True):
            true = find_row_peaks(true_row).above(TRUTH_PROMINENCE)
            if len(true):
                expected += count_as_the_paper(find_row_peaks(row).above(prominence), true, d_max, estimate.shape[1])
        assert counts == expected


def test_rows_without_truth_count_only_in_the_strict_score() -> None:
    estimate = TRUTH.copy()
    estimate[1] = lines_image([[30, 60]])[0]
    assert sweep(estimate, TRUTH, (0.1,))[0].fp == 0
    assert strict(estimate, TRUTH).fp == 2


def test_a_sweep_is_find_peaks_at_each_prominence() -> None:
    generator = np.random.default_rng(1)
    row = np.convolve(generator.random(BINS + 8), np.hanning(9), mode="valid")
    peaks = find_row_peaks(row)
    for prominence in (0.0, 0.05, 0.2, 0.5, 0.9):
        expected, _ = find_peaks(row / row.max(), height=0.5, prominence=prominence)
        np.testing.assert_array_equal(peaks.above(prominence), expected)
    found = [counts.tp + counts.fp for counts in sweep(row[None], TRUTH[:1], (0.0, 0.1, 0.3, 0.99))]
    assert found == sorted(found, reverse=True)
    assert found[0] > found[-1]


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_detection_does_not_depend_on_the_unit(factor: float) -> None:
    estimate = np.random.default_rng(0).random(TRUTH.shape) + TRUTH
    assert sweep(estimate * factor, TRUTH * factor, PROMINENCES) == sweep(estimate, TRUTH, PROMINENCES)


@given(
    st.lists(st.integers(0, 30), max_size=5, unique=True), st.lists(st.integers(0, 30), max_size=5, unique=True),
    st.integers(0, 6),
)  # fmt: skip
def test_matching_is_the_best_of_all_assignments(detected: list[int], true: list[int], d_max: int) -> None:
    first, second = np.array(sorted(detected), dtype=float), np.array(sorted(true), dtype=float)
    pairs = match(first, second, float(d_max))
    reach = np.minimum(d_max + 1e-9, half_separation(second) - 1e-9)
    best = (0, 0.0)
    places = [*range(len(second)), *[-1] * len(first)]
    for order in set(permutations(places, len(first))):
        chosen = [(i, j) for i, j in enumerate(order) if j >= 0]
        distances = [abs(first[i] - second[j]) for i, j in chosen]
        if all(distance <= reach[j] for distance, (_, j) in zip(distances, chosen, strict=True)):
            best = max(best, (len(chosen), -sum(distances)))
    assert len(pairs) == best[0]
    assert -sum(abs(first[i] - second[j]) for i, j in pairs) == pytest.approx(best[1])
    assert len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == len(pairs)


def test_counts_add_up() -> None:
    assert total([Counts(1, 2, 3, 4), Counts(5, 6, 7, 8)]) == Counts(6, 8, 10, 12)
    assert total([]) == Counts()
    assert Counts(tp=2, fp=1, fn=3).f1 == pytest.approx(2 * (2 / 3) * (2 / 5) / (2 / 3 + 2 / 5))


def test_images_of_other_shapes_are_refused() -> None:
    for call in (paper_sweep, strict_counts):
        with pytest.raises(InputError, match="images"):
            call(find_image_peaks(TRUTH), find_image_peaks(TRUTH[:2]))
    with pytest.raises(InputError, match="image"):
        find_image_peaks(TRUTH[0])


# GOSPA ---------------------------------------------------------------------------------------------------------------


def slow_gospa(estimated: NDArray, true: NDArray, cutoff: float, order: float) -> float:
    """The definition: the least over all partial assignments."""
    best = np.inf
    places = [*range(len(true)), *[-1] * len(estimated)]
    for chosen in set(permutations(places, len(estimated))):
        pairs = [(i, j) for i, j in enumerate(chosen) if j >= 0]
        left = len(estimated) + len(true) - 2 * len(pairs)
        cost = sum(np.linalg.norm(estimated[i] - true[j]) ** order for i, j in pairs) + cutoff**order / 2 * left
        best = min(best, cost)
    return float(best ** (1 / order))


POINTS = st.integers(0, 4).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.floats(-3, 3, width=16)))


@given(POINTS, POINTS, st.sampled_from([0.5, 2.0, 10.0]), st.sampled_from([1.0, 2.0]))
def test_gospa_is_its_definition(estimated: NDArray, true: NDArray, cutoff: float, order: float) -> None:
    found = gospa(estimated, true, cutoff, order)
    assert found.distance == pytest.approx(slow_gospa(estimated, true, cutoff, order), abs=1e-9)
    assert found.localisation + found.missed + found.false == pytest.approx(found.distance**order, abs=1e-9)
    assert gospa(true, estimated, cutoff, order).distance == pytest.approx(found.distance)


def test_gospa_parts() -> None:
    points = np.array([[0.0, 0.0], [5.0, 0.0]])
    assert gospa(points, points, 2.0).distance == 0.0
    empty = gospa(points[:0], points, 2.0)
    assert (empty.missed, empty.false, empty.localisation) == (4.0, 0.0, 0.0)
    extra = gospa(points, points[:0], 2.0)
    assert (extra.missed, extra.false) == (0.0, 4.0)
    near = gospa(points + 0.5, points[:1], 2.0)
    assert (near.assigned, near.localisation, near.false) == (1, pytest.approx(0.5), 2.0)
    assert gospa(points * 1e20, points * 0.0, 1e20).distance == pytest.approx(
        gospa(points, points * 0.0, 1.0).distance * 1e20
    )
    # Random clutter far from the truth: c^2 / 2 for each point.
    assert gospa(points + 100.0, points, 2.0).distance == pytest.approx(np.sqrt(4 * 2.0**2 / 2))


@pytest.mark.parametrize(
    ("estimated", "true", "cutoff", "order"),
    [
        (np.zeros((1, 2)), np.zeros((1, 3)), 1.0, 2.0), (np.zeros(2), np.zeros((1, 2)), 1.0, 2.0),
        (np.zeros((1, 2)), np.zeros((1, 2)), 0.0, 2.0), (np.zeros((1, 2)), np.zeros((1, 2)), 1.0, 0.5),
        (np.full((1, 2), np.nan), np.zeros((1, 2)), 1.0, 2.0),
    ],
)  # fmt: skip
def test_gospa_refuses_what_has_no_distance(estimated: NDArray, true: NDArray, cutoff: float, order: float) -> None:
    with pytest.raises(InputError, match="gospa"):
        gospa(estimated, true, cutoff, order)


# Images --------------------------------------------------------------------------------------------------------------


def test_image_metrics_of_perfect_and_empty_images() -> None:
    truth = np.random.default_rng(2).random((40, 60))
    empty = np.zeros_like(truth)
    assert nmse(truth, truth) == nmse_best_scaled(truth, truth) == 0.0
    assert nmse(empty, truth) == nmse_best_scaled(empty, truth) == 1.0
    assert nmse(3.0 * truth, truth) == pytest.approx(4.0)
    assert nmse_best_scaled(3.0 * truth, truth) == pytest.approx(0.0, abs=1e-12)
    assert psnr(truth, truth) == np.inf
    assert psnr(empty, np.ones_like(truth)) == 0.0
    assert ssim(truth, truth) == pytest.approx(1.0)
    assert ssim(empty, truth) < 0.02


def test_image_metrics_of_white_noise() -> None:
    generator = np.random.default_rng(4)
    truth = np.abs(generator.standard_normal((300, 300)))
    rayleigh = np.abs(generator.standard_normal((300, 300)) + 1j * generator.standard_normal((300, 300)))
    # 1 - (mean e mean t)^2 / (mean e^2 mean t^2): pi / 4 of a Rayleigh and 2 / pi of a half-normal image.
    assert nmse_best_scaled(rayleigh, truth) == pytest.approx(1.0 - np.pi / 4 * 2 / np.pi, abs=0.01)
    assert nmse(rayleigh, truth) == pytest.approx(2.0 + 1.0 - 2.0 * np.sqrt(np.pi / 2) * np.sqrt(2 / np.pi), abs=0.02)
    noisy = 0.5 + 0.1 * generator.standard_normal((300, 300))
    assert psnr(noisy, np.full((300, 300), 0.5)) == pytest.approx(20.0, abs=0.1)
    # Independent noise of variance 0.01 has no covariance: what is left is c_2 over the variances, as windows with
    # sum w^2 = 1 / (4 pi 1.5^2) see them, to first order.
    c2 = 0.03**2
    expected = c2 / (2 * 0.01 * (1.0 - 1.0 / (4.0 * np.pi * 1.5**2)) + c2)
    assert ssim(noisy, 0.5 + 0.1 * generator.standard_normal((300, 300))) == pytest.approx(expected, abs=0.01)


def test_ssim_is_that_of_torchmetrics() -> None:
    generator = np.random.default_rng(0)
    truth = generator.random((30, 26))
    estimate = truth + 0.3 * generator.standard_normal(truth.shape)
    images = [torch.from_numpy(image)[None, None] for image in (estimate, truth)]
    _, likeness = structural_similarity_index_measure(*images, data_range=1.0, sigma=1.5, return_full_image=True)
    # Its mean includes pixels whose window hangs over the edge.
    assert ssim(estimate, truth) == pytest.approx(float(likeness[..., 5:-5, 5:-5].mean()), abs=1e-9)


def test_level_image_has_a_fixed_scale() -> None:
    levels = level_image(np.array([2.0, 1.0, 0.1, 1e-2, 1e-9, 0.0]), peak=1.0, span_db=40.0)
    np.testing.assert_allclose(levels, [1.0, 1.0, 0.5, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(level_image(np.array([1e-21]), 1e-20, 40.0), [0.5])


@pytest.mark.parametrize(
    "call",
    [
        lambda: nmse(np.zeros(3), np.zeros(4)), lambda: nmse(np.ones(3), np.zeros(3)),
        lambda: psnr(np.full(3, np.nan), np.ones(3)), lambda: ssim(np.ones((5, 50)), np.ones((5, 50))),
        lambda: level_image(np.ones(3), 0.0), lambda: nmse(np.empty(0), np.empty(0)),
    ],
)  # fmt: skip
def test_images_that_cannot_be_compared_are_refused(call) -> None:
    with pytest.raises(InputError, match="expected"):
        call()


# Point spread --------------------------------------------------------------------------------------------------------


def beam(array: LineArray, u_true: float, u: NDArray[np.float64] = U) -> NDArray[np.float64]:
    snapshot = echoes(array, np.array([[u_true]]), np.ones((1, 1), dtype=complex))
    return ESTIMATORS["das"]().image(snapshot, array, u, 0.0)[0]


@pytest.mark.parametrize(
    ("array", "bins", "sidelobe_db"), [("full", 9.5, -13.2), ("sparse6", 7.7, -5.4), ("sparse4", 6.9, -1.5)]
)
def test_point_spread_of_the_paper_arrays(array: str, bins: float, sidelobe_db: float) -> None:
    spread = point_spread(beam(ARRAYS[array], 0.1234), U)
    assert spread is not None
    assert spread.u == pytest.approx(0.1234, abs=2e-4)
    assert spread.level == pytest.approx(1.0, abs=2e-3)
    assert spread.width / RADAR.grid.step == pytest.approx(bins, abs=0.1)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.15)


def test_point_spread_of_a_window() -> None:
    weights = angle_window("taylor-30", 256)
    line = LineArray(0.5 * np.arange(256.0), 1.0)
    u = np.linspace(-0.2, 0.2, 801)
    row = np.abs(line.manifold(u).T @ weights) / 256
    spread = point_spread(row, u)
    assert spread is not None
    width, sidelobe_db = window_point_spread(weights, 0.5)
    assert spread.width == pytest.approx(width, rel=0.01)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.3)


def test_integrated_sidelobes_of_a_filled_line() -> None:
    # A sinc has 90.3 % of its energy between its first zeros: -9.7 dB beside it.
    line = LineArray(0.5 * np.arange(200.0), 1.0)
    spread = point_spread(beam(line, 0.0, np.linspace(-1.0, 1.0, 4001)), np.linspace(-1.0, 1.0, 4001))
    assert spread is not None
    assert spread.islr_db == pytest.approx(10.0 * np.log10(0.0972 / 0.9028), abs=0.1)


def test_point_spread_of_lines_edges_and_nothing() -> None:
    line = np.zeros(50)
    line[20] = 3e-20
    spread = point_spread(line, U[:50])
    assert spread is not None
    assert spread.u == pytest.approx(U[20])
    assert spread.width < 1.5 * RADAR.grid.step
    assert spread.pslr_db == spread.islr_db == -np.inf
    edge = point_spread(np.linspace(0.0, 1.0, 50), U[:50])
    assert edge is not None
    assert edge.width == np.inf
    assert point_spread(np.zeros(50), U[:50]) is None
    for bad in (np.full(50, -1.0), np.full(50, np.nan), np.ones(3)):
        with pytest.raises(InputError, match="spectrum"):
            point_spread(bad, U[: len(bad)])


def test_point_spread_of_white_noise_knows_no_main_lobe() -> None:
    rows = np.random.default_rng(3).random((200, BINS))
    spreads = [point_spread(row, U) for row in rows]
    assert all(spread is not None for spread in spreads)
    sidelobes = [spread.pslr_db for spread in spreads if spread is not None]
    # The next largest of 450 numbers is 1 - 2 / 451; the peak between samples is a little higher than its sample.
    assert -0.3 < np.mean(sidelobes) < 20.0 * np.log10(1.0 - 1.0 / 451)
    # The main lobe is three bins or so, of mean square 1 and some 1 / 3 for its neighbours; all others have 1 / 3.
    integrated = np.median([spread.islr_db for spread in spreads if spread is not None])
    assert integrated == pytest.approx(10.0 * np.log10(447 / 3 / (1 + 2 / 3)), abs=1.0)


# Noise alone ---------------------------------------------------------------------------------------------------------


def test_false_alarms_of_delay_and_sum_are_those_of_rice() -> None:
    array, rows, probability = ARRAYS["full"], 6000, 1e-3
    image = ESTIMATORS["das"]().image(noise(array, rows, 2.0, np.random.default_rng(1)), array, U, 2.0)
    level = noise_level(array, 2.0, probability)
    assert np.mean(image > level) == pytest.approx(probability, rel=0.15)
    beta = 2.0 * np.pi / array.wavelength_m * np.std(array.positions_m)
    expected = np.sqrt(-np.log(probability)) * beta * 1.7 / np.sqrt(np.pi) * probability
    assert false_alarms(image, level) / rows == pytest.approx(expected, rel=0.15)
    assert false_alarms(np.zeros((3, 50)), level) == 0
    with pytest.raises(InputError, match="probability"):
        noise_level(array, 2.0, 0.0)


# Intervals -----------------------------------------------------------------------------------------------------------


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    generator = np.random.default_rng(1)
    inside = 0
    for draw in range(100):
        interval = bootstrap_mean(generator.normal(2.0, 1.0, 60), seed=draw)
        inside += interval.low <= 2.0 <= interval.high
    assert 86 <= inside <= 100
    wide = bootstrap_mean(generator.normal(2.0, 1.0, 60))
    assert wide.high - wide.low == pytest.approx(2 * 1.96 / np.sqrt(60), rel=0.25)


def test_bootstrap_is_repeatable_and_knows_no_spread_of_one() -> None:
    values = np.random.default_rng(0).random(30)
    assert bootstrap_mean(values, seed=3) == bootstrap_mean(values, seed=3)
    assert bootstrap_mean(values, seed=3) != bootstrap_mean(values, seed=4)
    one = bootstrap_mean(np.array([0.3]))
    assert one.value == 0.3
    assert np.isnan([one.low, one.high]).all()
    same = bootstrap_mean(np.full(10, 0.5))
    assert (same.value, same.low, same.high) == (0.5, 0.5, 0.5)


def test_ratios_are_of_sums() -> None:
    parts, wholes = np.array([1.0, 0.0, 9.0, 2.0]), np.array([2.0, 0.0, 10.0, 4.0])
    interval = bootstrap_ratio(parts, wholes)
    assert interval.value == 12 / 16
    assert interval.low < 12 / 16 < interval.high
    assert bootstrap_ratio(np.zeros(4), np.zeros(4)).value == 0.0
    assert bootstrap_ratio(parts, parts).low == 1.0


def test_wilson_intervals() -> None:
    # Newcombe 1998, table I: 81 of 263 and 0 of 20, Wilson without continuity correction.
    found = wilson(81, 263)
    assert (found.low, found.high) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    nothing = wilson(0, 20)
    assert (nothing.value, nothing.low, nothing.high) == (0.0, 0.0, pytest.approx(0.1611, abs=1e-4))
    assert wilson(20, 20).high == 1.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: bootstrap_mean(np.empty(0)), lambda: bootstrap_mean(np.array([1.0, np.nan])),
        lambda: bootstrap_ratio(np.ones(3), np.ones(4)), lambda: wilson(3, 2), lambda: wilson(0, 0),
    ],
)  # fmt: skip
def test_intervals_of_nothing_are_refused(call) -> None:
    with pytest.raises(InputError, match="expected"):
        call()
