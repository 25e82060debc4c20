"""Does the image explain the data? A test against hallucination that needs no truth.

The peaks of an image row are angles at which it claims targets. Least squares with their manifold vectors
re-synthesises the snapshot: what is left beyond the noise was missed; a peak without which no more is left was
invented.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.stats import chi2

from shared.errors import InputError
from trainer.estimators.array import LineArray, check_snapshots
from trainer.estimators.lines import refine_lines

PEAK_LEVEL = 0.1
"""Height and prominence of peaks that count, of the row's maximum: -20 dB."""
SUPPORT_PROBABILITY = 1e-4
"""That noise alone supports a peak at one angle; a row has some 50 angles."""
FIT_PROBABILITY = 0.01
"""That a complete set of targets fails the test of what is left."""
LEAST_NOISE = 1e-9
"""Noise power, relative to a row's mean power, where the data have less: rounding of complex64."""
REFINEMENTS = 4
"""Steps of the angles within their bins."""


@dataclass(frozen=True)
class Explanation:
    """Sums over the rows of an image that hold a snapshot.

    :param rows: number of rows
    :param explained_rows: rows in which what is left is no more than noise
    :param lines: peaks tested
    :param unsupported: peaks among them without which the fit is as good: hallucinations
    :param untested: peaks beyond half the number of channels, the weakest of their rows: least squares fits anything
    :param energy: of the snapshots [W]
    :param left: energy that the fit leaves [W]
    :param expected: energy that noise would leave [W]
    """

    rows: int
    explained_rows: int
    lines: int
    unsupported: int
    untested: int
    energy: float
    left: float
    expected: float

    @property
    def data_nmse(self) -> float:
        """Energy left over the snapshots' energy: 0 if the peaks explain all, 1 for an empty image; 0 without data."""
        return self.left / self.energy if self.energy > 0.0 else 0.0

    @property
    def explained_share(self) -> float:
        """Rows explained to the noise, of all; 0 without data."""
        return self.explained_rows / self.rows if self.rows else 0.0

    @property
    def hallucinated_share(self) -> float:
        """Unsupported peaks of those tested; 0 where there are none."""
        return self.unsupported / self.lines if self.lines else 0.0


def explain(
    image: NDArray[np.floating],
    u: NDArray[np.floating],
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    noise_power: float,
    level: float = PEAK_LEVEL,
) -> Explanation:
    """How well the peaks of an image [R, U] explain the snapshots [R, C] that it was made from.

    A peak stands for an angle within half a bin of it, the one that fits best. What K lines leave of a row is
    sigma^2 / 2 chi^2 with 2 (C - K) degrees of freedom if they are all there is. A line is unsupported if leaving it
    out raises that by less than -sigma^2 ln(1e-4); they are taken out one by one, the weakest first, so that of two
    peaks of one target one stays.

    :raises InputError: image and snapshots that do not fit each other, a negative noise power
    """
    check_snapshots(snapshots, array)
    if np.shape(image) != (len(snapshots), len(u)) or not noise_power >= 0.0:
        problem = f"an image {np.shape(image)} and noise_power = {noise_power!r}"
        raise InputError("residual", problem, f"an image {(len(snapshots), len(u))} and a power of at least 0 W")
    most = array.channels // 2
    limits = 0.5 * chi2.ppf(1.0 - FIT_PROBABILITY, 2 * (array.channels - np.arange(most + 1)))
    rows = np.asarray(snapshots, dtype=np.complex128)
    energies = np.sum(np.abs(rows) ** 2, axis=1)
    present = np.flatnonzero(energies > 0.0)
    peaks = [row_lines(np.asarray(image[row], dtype=np.float64), level) for row in present]
    lines = _within_their_bins(rows[present], [found[:most] for found in peaks], array, u)
    noise = np.maximum(noise_power, LEAST_NOISE * energies[present] / array.channels)
    explained = unsupported = 0
    left = expected = 0.0
    for x, angles, power in zip(rows[present], lines, noise, strict=True):
        manifold = array.manifold(angles)
        remains = _left(manifold, x)
        explained += int(remains <= power * limits[len(angles)])
        unsupported += len(angles) - _supported(manifold, x, -power * float(np.log(SUPPORT_PROBABILITY)))
        left, expected = left + remains, expected + float(power) * (array.channels - len(angles))
    tested = sum(len(angles) for angles in lines)
    untested = sum(len(found) for found in peaks) - tested
    energy = float(energies[present].sum())
    return Explanation(len(present), explained, tested, unsupported, untested, energy, left, expected)


def row_lines(row: NDArray[np.float64], level: float = PEAK_LEVEL) -> NDArray[np.intp]:
    """[K] bins of the peaks of a row [U], strongest first: height and prominence reach ``level`` of its maximum."""
    top = float(row.max(initial=0.0))
    if not top > 0.0:
        return np.empty(0, dtype=np.intp)
    # A zero at either end makes peaks of the first and last bin too.
    padded = np.pad(row / top, 1)
    peaks = find_peaks(padded, height=level, prominence=level)[0] - 1
    return peaks[np.argsort(row[peaks], kind="stable")[::-1]]


def _within_their_bins(
    rows: NDArray[np.complex128], peaks: list[NDArray[np.intp]], array: LineArray, u: NDArray[np.floating]
) -> list[NDArray[np.float64]]:
    """For each row [C] the angles at most half a bin from its peaks that explain it best, or nearly so."""
    axis = np.asarray(u, dtype=np.float64)
    half_bin = 0.5 * float(np.median(np.diff(axis))) if len(axis) > 1 else 0.0
    counts = np.array([len(bins) for bins in peaks], dtype=np.intp)
    lines = [axis[bins] for bins in peaks]
    # Rows with as many lines are refined together.
    for count in np.unique(counts[counts > 0]):
        group = np.flatnonzero(counts == count)
        start = np.array([lines[row] for row in group])
        refined = np.clip(refine_lines(rows[group], start, array, REFINEMENTS), start - half_bin, start + half_bin)
        for row, angles in zip(group, refined, strict=True):
            lines[row] = angles
    return lines


def _left(manifold: NDArray[np.complex128], x: NDArray[np.complex128]) -> float:
    basis, _ = np.linalg.qr(manifold)
    return float(np.sum(np.abs(x - basis @ (basis.conj().T @ x)) ** 2))


def _supported(manifold: NDArray[np.complex128], x: NDArray[np.complex128], threshold: float) -> int:
    """Number of lines [C, K] that remain after those are taken out that save less than ``threshold`` [W].

    Leaving out line k raises what is left by |s_k|^2 / [(A^H A)^-1]_kk.
    """
    kept = manifold
    while kept.shape[1]:
        inverse = np.linalg.pinv(kept.conj().T @ kept, rcond=1e-12, hermitian=True)
        amplitude = inverse @ (kept.conj().T @ x)
        saved = np.abs(amplitude) ** 2 / np.maximum(np.diag(inverse).real, np.finfo(np.float64).tiny)
        weakest = int(np.argmin(saved))
        if saved[weakest] >= threshold:
            break
        kept = np.delete(kept, weakest, axis=1)
    return kept.shape[1]
