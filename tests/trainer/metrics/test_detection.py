"""Detections: the paper's rules by hand and row by row; peaks of a row: where they stand, what limits that, two of
them, their width, and those of noise.
"""

from __future__ import annotations

from dataclasses import astuple
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR, U, deterministic_bound, echoes, lines_image, noise
from scipy.signal import find_peaks

from shared.signal.windows import angle_window
from shared.signal.windows import point_spread as window_point_spread
from trainer.estimators.base import ESTIMATORS, LineArray
from trainer.metrics.detection import (
    PROMINENCES,
    TRUTH_PROMINENCE,
    Counts,
    find_image_peaks,
    half_separation,
    match,
    paper_sweep,
    strict_counts,
)
from trainer.metrics.peaks import (
    false_alarms,
    noise_level,
    point_spread,
    resolved,
    single_source_bound,
    strongest_peaks,
)

TRUTH = lines_image([[100, 200], [], [50], [300, 310, 400]])


def sweep(
    estimate: NDArray, truth: NDArray, prominences: tuple[float, ...], d_max: int = 2, threshold: float = 0.5
) -> list[Counts]:
    """The paper's counts of an image; the truth's peaks are found in the same way, those that stand out."""
    true = find_image_peaks(truth).above(TRUTH_PROMINENCE)
    return paper_sweep(find_image_peaks(estimate, threshold), true, prominences, d_max)


def strict(estimate: NDArray, truth: NDArray, d_max: float = 2) -> Counts:
    return strict_counts(find_image_peaks(estimate).above(0.05), find_image_peaks(truth).above(0.05), d_max)


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
    assert count_as_the_paper(np.array([], dtype=int), true, 2, 450).tp == 0
    one = count_as_the_paper(np.array([11]), np.array([10, 12]), 2, 450)
    assert (one.tp, one.fn) == (1, 0)
    assert not len(match(np.array([11.0]), np.array([10.0, 12.0]), 2.0))


def row_peaks(row: NDArray, prominence: float = 0.0) -> tuple[NDArray, NDArray]:
    """(bins, prominences) of a row above half of its maximum, by SciPy; none of an empty row."""
    if not row.any():
        return np.empty(0, dtype=np.intp), np.empty(0)
    bins, found = find_peaks(row / row.max(), height=0.5, prominence=prominence)
    return bins, found["prominences"]


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
        rows = [row_peaks(row) for row in image]
        for found, (bins, _) in zip(peaks.by_row(), rows, strict=True):
            np.testing.assert_array_equal(found, bins)
        np.testing.assert_array_equal(peaks.prominence, np.concatenate([prominence for _, prominence in rows]))
    assert [len(bins) for bins in find_image_peaks(np.zeros((3, 9))).by_row()] == [0, 0, 0]


@pytest.mark.parametrize("d_max", [0, 2, 4])
def test_a_sweep_over_an_image_is_the_rules_row_by_row(d_max: int) -> None:
    estimate, truth = crowded_images()
    for prominence, counts in zip(PROMINENCES, sweep(estimate, truth, PROMINENCES, d_max), strict=True):
        of_rows = [
            astuple(count_as_the_paper(row_peaks(row, prominence)[0], true, d_max, estimate.shape[1]))
            for row, true in zip(estimate, (row_peaks(row, TRUTH_PROMINENCE)[0] for row in truth), strict=True)
            if len(true)
        ]
        assert astuple(counts) == tuple(np.sum(of_rows, axis=0))


def test_rows_without_truth_count_only_in_the_strict_score() -> None:
    estimate = TRUTH.copy()
    estimate[1] = lines_image([[30, 60]])[0]
    assert sweep(estimate, TRUTH, (0.1,))[0].fp == 0
    assert strict(estimate, TRUTH).fp == 2


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


def test_the_bound_of_one_source_is_the_general_one_and_that_of_a_filled_line() -> None:
    for array in ARRAYS.values():
        general = deterministic_bound(array, np.array([0.3]), np.array([[1.0 + 0.0j]]), 0.01)
        assert general[0, 0] == pytest.approx(single_source_bound(array, 100.0))
    # A filled line of length L has sum (p - mean p)^2 = C L^2 / 12, but for C^-2, and a cell lambda / L.
    full = ARRAYS["full"]
    expected = full.resolution_cell / (2.0 * np.pi) * np.sqrt(6.0 / (48 * 100.0))
    assert np.sqrt(single_source_bound(full, 100.0)) == pytest.approx(expected, rel=1e-3)


def test_random_angles_resolve_as_often_as_chance_says() -> None:
    separation = 0.4
    trials = 4000
    true = np.tile([[-separation / 2, separation / 2]], (trials, 1))
    found = np.sort(np.random.default_rng(0).uniform(-1.0, 1.0, (trials, 2)), axis=1)
    # Each angle must fall in its half of an interval of twice the separation: 2 (s / 2)^2.
    expected = 2.0 * (separation / 2.0) ** 2
    assert np.mean(resolved(found, true)) == pytest.approx(expected, abs=4.0 * np.sqrt(expected / trials))


def test_perfect_angles_resolve_and_an_empty_image_does_not() -> None:
    true = np.array([[-0.1, 0.1], [0.2, 0.25], [-0.5, -0.4]])
    assert resolved(true, true).all()
    assert not resolved(strongest_peaks(np.zeros((3, len(U))), U, 2), true).any()
    one = np.column_stack([true[:, 0], np.full(3, np.nan)])
    assert not resolved(one, true).any()
    # A single peak in the middle is not two.
    assert not resolved(np.repeat(true.mean(axis=1, keepdims=True), 2, axis=1), true).any()


def test_false_alarms_of_delay_and_sum_are_those_of_rice() -> None:
    array, rows, probability = ARRAYS["full"], 6000, 1e-3
    image = ESTIMATORS["das"]().image(noise(array, rows, 2.0, np.random.default_rng(1)), array, U, 2.0)
    level = noise_level(array, 2.0, probability)
    assert np.mean(image > level) == pytest.approx(probability, rel=0.15)
    beta = 2.0 * np.pi / array.wavelength_m * np.std(array.positions_m)
    expected = np.sqrt(-np.log(probability)) * beta * 1.7 / np.sqrt(np.pi) * probability
    assert false_alarms(image, level) / rows == pytest.approx(expected, rel=0.15)
    assert false_alarms(np.zeros((3, 50)), level) == 0


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


def test_a_main_lobe_reaches_to_the_minima_on_both_sides() -> None:
    spread = point_spread(np.array([0.4, 0.2, 1.0, 0.6, 0.3, 0.5]), np.arange(6.0))
    assert spread is not None
    assert spread.islr_db == pytest.approx(10.0 * np.log10((0.16 + 0.25) / (0.04 + 1.0 + 0.36 + 0.09)))


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
