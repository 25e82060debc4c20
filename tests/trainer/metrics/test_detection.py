"""Detections: a perfect image, an empty one, white noise, the paper's rules by hand and row by row."""

from dataclasses import astuple
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper_arrays import lines_image
from scipy.signal import find_peaks

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

TRUTH = lines_image([[100, 200], [], [50], [300, 310, 400]])


def sweep(
    estimate: NDArray, truth: NDArray, prominences: tuple[float, ...], d_max: int = 2, threshold: float = 0.5
) -> list[Counts]:
    """The paper's counts of an image; the truth's peaks are found in the same way, those that stand out."""
    true = find_image_peaks(truth).above(TRUTH_PROMINENCE)
    return paper_sweep(find_image_peaks(estimate, threshold), true, prominences, d_max)


def strict(estimate: NDArray, truth: NDArray, d_max: float = 2) -> Counts:
    return strict_counts(find_image_peaks(estimate).above(0.05), find_image_peaks(truth).above(0.05), d_max)


def test_a_perfect_image_detects_all_and_nothing_else() -> None:
    for counts in (*sweep(TRUTH, TRUTH, (0.0, 0.3)), strict(TRUTH, TRUTH)):
        assert (counts.tp, counts.fp, counts.fn) == (6, 0, 0)


def test_an_empty_image_scores_zero() -> None:
    for counts in (*sweep(np.zeros_like(TRUTH), TRUTH, (0.0,)), strict(np.zeros_like(TRUTH), TRUTH)):
        assert (counts.tp, counts.fp, counts.fn) == (0, 0, 6)


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
