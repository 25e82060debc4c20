"""Detections in angle, counted as the paper counts them and, beside that, one to one.

An angular spectrum is normalised to a maximum of 1 and its peaks are those of :func:`scipy.signal.find_peaks` above 0.5
whose prominence reaches a threshold; sweeping that threshold gives the paper's Fig. 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment
from scipy.signal import find_peaks

THRESHOLD = 0.5
"""Height of a peak that counts, of the row's maximum (paper, section IV-C)."""
TRUTH_PROMINENCE = 0.05
"""The paper does not say how the truth's peaks are found; ours do not move with the sweep."""
PROMINENCES = tuple(np.round(np.linspace(0.0, 0.95, 20), 2).tolist())
D_MAX_BINS = (2, 4)
"""Largest distance of a detection from a truth that it is counted for (paper) [bins]."""


@dataclass(frozen=True)
class Counts:
    """True and false positives and negatives of an image; no true negatives where the rule does not count them."""

    tp: int = 0
    fp: int = 0
    fn: int = 0
    tn: int = 0


@dataclass(frozen=True, eq=False)
class ImagePeaks:
    """Peaks of an image [R, U], each row normalised by itself.

    :param shape: (R, U)
    :param rows: [N] of the peaks, rising
    :param bins: [N], rising within a row
    :param prominence: [N] of the row's maximum
    """

    shape: tuple[int, int]
    rows: NDArray[np.intp]
    bins: NDArray[np.intp]
    prominence: NDArray[np.float64]

    def above(self, prominence: float) -> ImagePeaks:
        """Those of at least this prominence."""
        kept = self.prominence >= prominence
        return ImagePeaks(self.shape, self.rows[kept], self.bins[kept], self.prominence[kept])

    def by_row(self) -> list[NDArray[np.intp]]:
        """R arrays of bins, rising."""
        edges = np.searchsorted(self.rows, np.arange(self.shape[0] + 1))
        return [self.bins[first:last] for first, last in pairwise(edges)]


def find_image_peaks(image: NDArray[np.floating], threshold: float = THRESHOLD) -> ImagePeaks:
    """The peaks of all rows of an image [R, U] above ``threshold`` of their row's maximum, in one pass.

    Those that :func:`scipy.signal.find_peaks` finds in each row, with their prominences; none of an empty row. The
    first and the last bin are no peaks.
    """
    magnitude = np.asarray(image, dtype=np.float64)
    rows, columns = magnitude.shape
    top = magnitude.max(axis=1, initial=0.0)[:, None]
    # The rows stand one after the other with an infinite sample between them. It ends the search for a peak's
    # prominence as the end of the row does. It makes no peak of the row's last bin, and is above the heights asked for.
    line = np.full((rows, columns + 1), np.inf)
    line[:, :columns] = np.divide(magnitude, top, out=np.zeros_like(magnitude), where=top > 0.0)
    places, found = find_peaks(line.ravel(), height=(threshold, 1.0), prominence=0.0)
    return ImagePeaks((rows, columns), places // (columns + 1), places % (columns + 1), found["prominences"])


def paper_sweep(detected: ImagePeaks, true: ImagePeaks, prominences: Sequence[float], d_max: int) -> list[Counts]:
    """Counts by the rules of the paper, section IV-C, one for each prominence that a detection needs.

    TP: detected peaks at most d_max from a truth; FP: the other detected peaks. One detection may serve several truths,
    and several detections one. FN: truths without a detection within d_max. TN: bins that hold neither a detection
    nor a truth. Over all rows with a truth; the others are left out, so that rows cannot be what TN counts.

    :param detected: of the estimate, of any prominence
    :param true: of the truth, of the prominence that makes one
    """
    # A truth's bins and those within d_max of it, and the most prominent detection within d_max of each bin.
    truth = np.zeros(true.shape, dtype=bool)
    truth[true.rows, true.bins] = True
    strength = np.full(detected.shape, -np.inf)
    strength[detected.rows, detected.bins] = detected.prominence
    window = 2 * d_max + 1
    near_truth = maximum_filter1d(truth, window, axis=1, mode="constant", cval=0)
    nearest = maximum_filter1d(strength, window, axis=1, mode="constant", cval=-np.inf)
    served = nearest[true.rows, true.bins]
    counted = np.asarray(truth.any(axis=1))
    judged = counted[detected.rows]
    place = detected.rows[judged], detected.bins[judged]
    prominence, hit, on_truth = detected.prominence[judged], near_truth[place], truth[place]
    cells = int(counted.sum()) * true.shape[1]
    counts = []
    for least in prominences:
        kept = prominence >= least
        tp, fn = int(np.sum(kept & hit)), int(np.sum(served < least))
        occupied = len(true.bins) + int(np.sum(kept & ~on_truth))
        counts.append(Counts(tp, int(kept.sum()) - tp, fn, cells - occupied))
    return counts


def strict_counts(detected: ImagePeaks, true: ImagePeaks, d_max: float) -> Counts:
    """One-to-one counts of an image over all its rows, those without a truth too: there every detection is false.

    Each detection serves one truth and each truth one detection, see :func:`match`.
    """
    rows = zip(detected.by_row(), true.by_row(), strict=True)
    matched = sum(len(match(found.astype(np.float64), truth.astype(np.float64), d_max)) for found, truth in rows)
    return Counts(matched, len(detected.bins) - matched, len(true.bins) - matched)


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
    # A forbidden pair costs more than all allowed pairs together.
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
