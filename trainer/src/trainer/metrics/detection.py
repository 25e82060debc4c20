"""Detections in angle, counted as the paper counts them and, beside that, one to one.

An angular spectrum is normalised to a maximum of 1 and its peaks are those of :func:`scipy.signal.find_peaks` above 0.5
whose prominence reaches a threshold; sweeping that threshold gives the paper's Fig. 11.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.signal import find_peaks

from shared.errors import InputError

THRESHOLD = 0.5
"""Height of a peak that counts, of the row's maximum (paper, section IV-C)."""
TRUTH_PROMINENCE = 0.05
"""The paper does not say how the truth's peaks are found; ours do not move with the sweep."""
PROMINENCES = tuple(np.round(np.linspace(0.0, 0.95, 20), 2).tolist())
D_MAX_BINS = (2, 4)
"""Largest distance of a detection from a truth that it is counted for (paper) [bins]."""


@dataclass(frozen=True)
class Counts:
    """Counts of detections, of one row or summed over many.

    :param tp: true positives
    :param fp: false positives
    :param fn: false negatives
    :param tn: true negatives; 0 where the rule does not count them
    """

    tp: int = 0
    fp: int = 0
    fn: int = 0
    tn: int = 0

    def __add__(self, other: Counts) -> Counts:
        return Counts(self.tp + other.tp, self.fp + other.fp, self.fn + other.fn, self.tn + other.tn)

    @property
    def detection_rate(self) -> float:
        """Recall, TP / (TP + FN); 0 where there is nothing to detect."""
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def false_alarm_rate(self) -> float:
        """FP / (TN + FP)."""
        return _ratio(self.fp, self.tn + self.fp)

    @property
    def precision(self) -> float:
        """TP / (TP + FP); 0 where nothing was detected."""
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN)."""
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks of one normalised spectrum.

    :param bins: [N] indices, rising
    :param prominence: [N] how far each stands out of its surroundings, of the maximum
    """

    bins: NDArray[np.intp]
    prominence: NDArray[np.float64]

    def above(self, prominence: float) -> NDArray[np.intp]:
        """[n] indices of the peaks of at least this prominence: what find_peaks(prominence=...) gives."""
        return self.bins[self.prominence >= prominence]


def find_row_peaks(spectrum: NDArray[np.floating], threshold: float = THRESHOLD) -> Peaks:
    """Peaks of a spectrum [U] above ``threshold`` of its maximum, with their prominences; none of an empty row.

    The first and the last bin are no peaks, as :func:`scipy.signal.find_peaks` has it.
    """
    row = np.asarray(spectrum, dtype=np.float64)
    top = float(row.max(initial=0.0))
    if not top > 0.0:
        return Peaks(np.empty(0, dtype=np.intp), np.empty(0))
    bins, found = find_peaks(row / top, height=threshold, prominence=0.0)
    return Peaks(bins, found["prominences"])


def count_as_the_paper(detected: NDArray[np.intp], true: NDArray[np.intp], d_max: float, bins: int) -> Counts:
    """Counts of one row by the rules of the paper, section IV-C.

    TP: detected peaks at most d_max from a truth; FP: the other detected peaks. One detection may serve several truths,
    and several detections one. FN: truths without a detection within d_max. TN: bins that hold neither a detection
    nor a truth (rows without a truth are left out, so that rows cannot be what is meant).

    :param detected: [n] bins
    :param true: [m] bins
    :param bins: U
    """
    distance = np.abs(np.subtract.outer(detected, true))
    near = distance <= d_max
    hits = int(near.any(axis=1).sum())
    occupied = len(np.union1d(detected, true))
    return Counts(hits, len(detected) - hits, len(true) - int(near.any(axis=0).sum()), bins - occupied)


def paper_sweep(
    estimate: NDArray[np.floating],
    truth: NDArray[np.floating],
    prominences: Sequence[float] = PROMINENCES,
    d_max: float = D_MAX_BINS[0],
    threshold: float = THRESHOLD,
    truth_prominence: float = TRUTH_PROMINENCE,
) -> list[Counts]:
    """The paper's counts of one image, one for each prominence, over all rows with a peak in the truth.

    :param estimate: [R, U] magnitudes
    :param truth: [R, U] magnitudes
    :raises InputError: images of different shapes
    """
    _same_shape(estimate, truth)
    totals = [Counts() for _ in prominences]
    for row, true_row in zip(estimate, truth, strict=True):
        true = find_row_peaks(true_row, threshold).above(truth_prominence)
        if not len(true):
            continue
        peaks = find_row_peaks(row, threshold)
        for index, prominence in enumerate(prominences):
            totals[index] += count_as_the_paper(peaks.above(prominence), true, d_max, len(row))
    return totals


def strict_counts(
    estimate: NDArray[np.floating],
    truth: NDArray[np.floating],
    prominence: float = TRUTH_PROMINENCE,
    d_max: float = D_MAX_BINS[0],
    threshold: float = THRESHOLD,
    truth_prominence: float = TRUTH_PROMINENCE,
) -> Counts:
    """One-to-one counts of an image over all its rows, those without a truth too: there every detection is false.

    :param estimate: [R, U] magnitudes
    :param truth: [R, U] magnitudes
    :raises InputError: images of different shapes
    """
    _same_shape(estimate, truth)
    total = Counts()
    for row, true_row in zip(estimate, truth, strict=True):
        true = find_row_peaks(true_row, threshold).above(truth_prominence)
        detected = find_row_peaks(row, threshold).above(prominence)
        total += count_one_to_one(detected.astype(np.float64), true.astype(np.float64), d_max)
    return total


def count_one_to_one(detected: NDArray[np.float64], true: NDArray[np.float64], d_max: float) -> Counts:
    """TP, FP and FN with each detection serving one truth and each truth one detection, see :func:`match`."""
    matched = len(match(detected, true, d_max))
    return Counts(matched, len(detected) - matched, len(true) - matched)


def match(detected: NDArray[np.float64], true: NDArray[np.float64], d_max: float) -> NDArray[np.intp]:
    """[pairs, 2] (detection, truth) of the assignment with most pairs and, among those, the least sum of distances.

    A truth takes a detection at a distance of at most d_max and of less than half the distance to the next truth: one
    peak between two targets is not a detection of both, nor of either. Hungarian method (Kuhn 1955).

    :param detected: [n] positions on a line, in any unit
    :param true: [m] positions
    :param d_max: in the same unit
    """
    if not len(detected) or not len(true):
        return np.empty((0, 2), dtype=np.intp)
    distance = np.abs(np.subtract.outer(detected, true))
    allowed = (distance <= d_max) & (distance < half_separation(true)[None, :])
    # A pair that is not allowed costs more than all allowed ones together.
    forbidden = (distance[allowed].sum() + 1.0) * (len(detected) + len(true))
    first, second = linear_sum_assignment(np.where(allowed, distance, forbidden))
    kept = allowed[first, second]
    return np.stack([first[kept], second[kept]], axis=1)


def half_separation(true: NDArray[np.float64]) -> NDArray[np.float64]:
    """[m] half the distance of each position to its nearest neighbour, infinite for a single one."""
    if len(true) < 2:
        return np.full(len(true), np.inf)
    distance = np.abs(np.subtract.outer(true, true))
    np.fill_diagonal(distance, np.inf)
    return 0.5 * distance.min(axis=1)


def total(counts: Iterable[Counts]) -> Counts:
    """The sum of counts."""
    return sum(counts, start=Counts())


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


def _same_shape(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> None:
    if np.shape(estimate) != np.shape(truth) or np.ndim(truth) != 2:
        raise InputError("images", f"shapes {np.shape(estimate)} and {np.shape(truth)}", "two images [R, U]")
