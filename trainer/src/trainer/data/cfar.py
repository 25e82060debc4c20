"""The cells of a frame that hold an echo, by a test of ordered statistics (OS-CFAR).

A cell's power X is summed over its C channels. X is compared with the k-th smallest of N cells around it in range and
Doppler (Rohling 1983, "Radar CFAR thresholding in clutter and multiple target situations", IEEE Trans. AES 19):

    X > alpha X_(k)

In noise of unit power X is of a Gamma distribution of shape C. With Q its upper tail and V = 1 - Q(X_(k)), which is of
a Beta distribution with k and N - k + 1, the probability that noise alone passes is

    P = E[Q(alpha Q^-1(1 - V))]

For C = 1 it is prod_{i<k} (N - i) / (N - i + alpha), Rohling's eq. (11). It holds exactly for the cells that are taken:
a Hann window correlates the noise of cells less than three apart, so that they stand three apart.

Up to N - k of them may hold echoes. At the ends of range, as of Doppler, the other end serves.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import betaincinv, betaln, gammaincc, gammainccinv, xlog1py, xlogy

from shared.physics.errors import InputError
from shared.signal.spectrum import DopplerSelection, selection_at, strongest_doppler

CELL_FALSE_ALARM = 1e-3
"""Probability that a cell of noise is looked at. The fit decides whether it lists a line there: what it would list
stands far above this."""
APART, REACH = 3, 9
"""Cells between those compared with, and to the farthest of them."""
RANK_SHARE = 0.5
"""k / N: half of the surroundings may hold echoes."""
QUADRATURE, FEW_POINTS = 200, 32
"""Points of the expectation: within 1e-6 of Rohling's product for C = 1; and of what is told of the thresholds."""


def cfar_cells(spectra: NDArray[np.complexfloating]) -> tuple[DopplerSelection, NDArray[np.bool_]]:
    """The cells of ``spectra`` [R, chirps, C] that pass, and those beside them in range at the same Doppler.

    :return: (D cells of every range bin, D the most of any; where a bin has fewer its first again, [D, R] which of them
        pass and are local maxima in Doppler)
    :raises InputError: too few cells to compare with
    """
    power: NDArray[np.float64] = np.sum(np.abs(spectra) ** 2, axis=2, dtype=np.float64)
    passed = os_cfar(power, spectra.shape[2], CELL_FALSE_ALARM)
    # The first stands in where a bin has none.
    strongest = strongest_doppler(power)
    if power.shape[1] == 2:  # both cells hold the same
        passed[:, 0] = False
    wanted = passed.copy()
    wanted[1:] |= passed[:-1]
    wanted[:-1] |= passed[1:]
    peaks = (power > np.roll(power, 1, axis=1)) & (power >= np.roll(power, -1, axis=1))
    # Of one chirp, and of two, which a Hann window makes one, no cell is above its neighbour.
    np.put_along_axis(peaks, strongest[:, None], True, axis=1)
    peaks &= passed
    rank = np.where(wanted, -power, np.inf)
    order = np.argsort(rank, axis=1, kind="stable")[:, : max(int(wanted.sum(axis=1).max(initial=0)), 1)]
    there = np.take_along_axis(wanted, order, axis=1)
    first = np.where(there[:, 0], order[:, 0], strongest)
    cells = np.where(there, order, first[:, None]).T
    return selection_at(spectra, cells), (there & np.take_along_axis(peaks, order, axis=1)).T


def os_cfar(power: NDArray[np.floating], channels: int, false_alarm: float) -> NDArray[np.bool_]:
    """[R, chirps] which cells pass, of the powers summed over the channels.

    :raises InputError: too few cells to compare with
    """
    lags = _lags(power.shape)
    rank = _rank(len(lags))
    around = np.stack([np.roll(power, lag, axis=(0, 1)) for lag in lags])
    level = np.partition(around, rank - 1, axis=0)[rank - 1]
    return np.asarray(power > cfar_factor(channels, len(lags), rank, false_alarm) * level)


@cache
def cfar_factor(channels: int, cells: int, rank: int, false_alarm: float) -> float:
    """alpha of the module's equation for C channels, N cells and k = ``rank``."""

    def excess(log_factor: float) -> float:
        probability = cfar_probability(np.exp(log_factor), channels, cells, rank)
        return float(np.log(max(probability, 1e-300)) - np.log(false_alarm))

    return float(np.exp(brentq(excess, 0.0, 12.0)))


def cfar_probability(factor: float, channels: int, cells: int, rank: int) -> float:
    """P of the module's equation."""
    level, likely = _levels(channels, cells, rank)
    return float(likely @ gammaincc(channels, factor * level))


def cfar_thresholds(shape: tuple[int, int], channels: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(alpha X_(k) [n], probabilities [n]) that cells of noise of ``shape`` [R, chirps] are compared with."""
    cells = len(_lags(shape))
    rank = _rank(cells)
    level, likely = _levels(channels, cells, rank, FEW_POINTS)
    return cfar_factor(channels, cells, rank, CELL_FALSE_ALARM) * level, likely


def _levels(
    channels: int, cells: int, rank: int, points: int = QUADRATURE
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(X_(k) [n], probabilities [n]) in noise."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    above = cells - rank + 1
    low, high = betaincinv(rank, above, 1e-13), 1.0 - betaincinv(above, rank, 1e-13)
    v = low + 0.5 * (high - low) * (nodes + 1.0)
    density = np.exp(xlogy(rank - 1.0, v) + xlog1py(above - 1.0, -v) - betaln(rank, above))
    return gammainccinv(channels, 1.0 - v), 0.5 * (high - low) * weights * density


def _lags(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Of the cells that one is compared with.

    :raises InputError: too few
    """
    away = [_distances(size) for size in shape]
    lags = [(i, j) for i in away[0] for j in away[1] if i or j]
    if not lags:
        problem = f"{shape[0]} range bins and {shape[1]} Doppler cells"
        raise InputError("--cells", f"'all' of {problem}", "at least 9 of either, or 'peaks'")
    return lags


def _rank(cells: int) -> int:
    """k of N = ``cells``."""
    return max(int(RANK_SHARE * cells), 1)


def _distances(size: int) -> list[int]:
    """Of cells compared with along one axis, which is a circle; they stand apart across its ends too."""
    reach = min(REACH, (size - APART) // 2) // APART * APART
    return list(range(-reach, reach + 1, APART)) if reach > 0 else [0]
