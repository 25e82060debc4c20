"""Does the image explain the data? A test against hallucination that needs no truth.

The peaks of an image row are angles at which it claims targets. Least squares with their manifold vectors
re-synthesises the snapshot: what is left beyond the noise was missed; a peak without which no more is left was
invented.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from trainer.estimators.array import LineArray, check_snapshots
from trainer.estimators.lines import RIDGE, line_amplitudes, refine_lines
from trainer.metrics.detection import find_image_peaks

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

    :param explained_rows: rows in which what is left is no more than noise
    :param lines: peaks tested: of a row at most half as many as channels, the strongest; least squares fits anything
    :param unsupported: peaks among them without which the fit is as good: hallucinations
    :param energy: of the snapshots [W]
    :param left: energy that the fit leaves [W]
    """

    rows: int
    explained_rows: int
    lines: int
    unsupported: int
    energy: float
    left: float


def explain(
    image: NDArray[np.floating],
    u: NDArray[np.floating],
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    noise_power: float,
    chirps: int = 1,
) -> Explanation:
    """How well the peaks of an image [R, U] explain the snapshots [R, C] that it was made from.

    A peak stands for an angle within half a bin of it, the one that fits best. What K lines leave of a row is
    sigma^2 / 2 chi^2 with 2 (C - K) degrees of freedom if they are all there is. A line is unsupported if leaving it
    out raises that by less than -sigma^2 ln(1e-4); they are taken out one by one, the weakest first, so that of two
    peaks of one target one stays. Noise that is the strongest of M Doppler cells exceeds what one exceeds with the
    probability 1 - (1 - p)^(1 / M) with the probability p at most: both tests take that in place of p.

    :param chirps: M, of whose Doppler cells a row is the strongest
    :raises InputError: snapshots that are not those of the array, or not finite
    """
    check_snapshots(snapshots, array)
    most = array.channels // 2
    fails, supports = (of_one_cell(p, chirps) for p in (FIT_PROBABILITY, SUPPORT_PROBABILITY))
    limits = gammainccinv(array.channels - np.arange(most + 1), fails)
    rows = np.asarray(snapshots, dtype=np.complex128)
    energies = np.sum(np.abs(rows) ** 2, axis=1)
    present = np.flatnonzero(energies > 0.0)
    lines = [found[:most] for found in image_lines(np.asarray(image)[present])]
    noise = np.maximum(noise_power, LEAST_NOISE * energies[present] / array.channels)
    explained = unsupported = 0
    left = 0.0
    for group, bins in _by_count(lines):
        x, power, count = rows[present[group]], noise[group], bins.shape[1]
        angles = _within_their_bins(x, bins, array, u)
        remains = np.sum(np.abs(line_amplitudes(x, angles, array)[1]) ** 2, axis=1)
        explained += int(np.sum(remains <= power * limits[count]))
        needed = supported_lines(x, angles, array, -power * float(np.log(supports)))
        unsupported += int(np.sum(count - needed))
        left += float(remains.sum())
    tested = sum(len(found) for found in lines)
    energy = float(energies[present].sum())
    return Explanation(len(present), explained, tested, unsupported, energy, left)


def of_one_cell(probability: float, chirps: int) -> float:
    """What happens in any of ``chirps`` independent Doppler cells with this probability does in one with that."""
    return float(-np.expm1(np.log1p(-probability) / chirps))


def image_lines(image: NDArray[np.floating]) -> list[NDArray[np.intp]]:
    """R arrays of the bins of the peaks of an image [R, U], the strongest of a row first.

    Height and prominence of a peak reach :data:`PEAK_LEVEL` of the row's maximum.
    """
    # The zeros at both ends make peaks of the first and last bin too.
    peaks = find_image_peaks(np.pad(image, ((0, 0), (1, 1))), PEAK_LEVEL).above(PEAK_LEVEL)
    return [
        bins[np.argsort(row[bins], kind="stable")[::-1]]
        for row, bins in zip(np.asarray(image), (found - 1 for found in peaks.by_row()), strict=True)
    ]


def _by_count(lines: list[NDArray[np.intp]]) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """(rows [n], their lines [n, K]) for each number of lines: rows with as many are worked on together."""
    counts = np.array([len(bins) for bins in lines], dtype=np.intp)
    groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
    return [(group, np.stack([lines[row] for row in group])) for group in groups]


def _within_their_bins(
    x: NDArray[np.complex128], bins: NDArray[np.intp], array: LineArray, u: NDArray[np.floating]
) -> NDArray[np.float64]:
    """[B, K] the angles at most half a bin from the peaks [B, K] that explain x [B, C] best, or nearly so."""
    axis = np.asarray(u, dtype=np.float64)
    start = axis[bins]
    if not bins.shape[1]:
        return start
    half_bin = 0.5 * float(np.median(np.diff(axis))) if len(axis) > 1 else 0.0
    return np.clip(refine_lines(x, start, array, REFINEMENTS), start - half_bin, start + half_bin)


def supported_lines(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray, threshold: NDArray[np.float64]
) -> NDArray[np.intp]:
    """[B] of the lines u [B, K], how many remain of a row x [B, C] after those are taken out, the weakest first, that
    save less than ``threshold`` [B] [W].

    Leaving out line k raises what is left by |s_k|^2 / [(A^H A)^-1]_kk, s = A^+ x. With the ridge of
    :mod:`trainer.estimators.lines` of two lines at one angle either saves next to nothing and one goes.
    """
    remaining = np.full(len(x), u.shape[1])
    atoms = np.moveaxis(array.manifold(u), 0, 1)
    adjoint = np.swapaxes(atoms, 1, 2).conj()
    gram, matched = adjoint @ atoms, (adjoint @ x[..., None])[..., 0]
    gram[:, np.arange(u.shape[1]), np.arange(u.shape[1])] += RIDGE * array.channels
    going = np.arange(len(x))
    # All rows that are still worked on have the same number of lines, and lose one a round.
    for count in range(u.shape[1], 0, -1):
        inverse = np.linalg.inv(gram)
        amplitude = (inverse @ matched[..., None])[..., 0]
        variance = np.einsum("bkk->bk", inverse).real
        saved = np.abs(amplitude) ** 2 / np.maximum(variance, np.finfo(np.float64).tiny)
        weakest = np.argmin(saved, axis=1)
        loses = saved[np.arange(len(going)), weakest] < threshold[going]
        going = going[loses]
        if not len(going):
            break
        remaining[going] -= 1
        kept = np.arange(count) != weakest[loses, None]
        matched = matched[loses][kept].reshape(len(going), count - 1)
        gram = gram[loses][kept[:, :, None] & kept[:, None, :]].reshape(len(going), count - 1, count - 1)
    return remaining
