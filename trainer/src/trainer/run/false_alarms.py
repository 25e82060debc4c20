"""What a line must pass, for a number of false lines in a frame of noise.

The matched filter of a group of range bins, over the angle u and the range offset r, is in noise a complex Gaussian
field z of unit variance. Its local maxima with |z|^2 above a high level t have the expected density (Worsley 1994,
"Local maxima and the expected Euler characteristic of excursion sets of chi-squared, F and t fields", Adv. Appl. Prob.
26, of a chi-squared field of two degrees of freedom)

    beta sqrt(t / pi) exp(-t)                               over u, of a group of one bin (also Rice 1944)
    beta sqrt(lambda) (2 t - 1) / (2 pi) exp(-t)            over u and r, of more

with beta = k std(p) over the elements' places p and lambda = |P_b b'|^2 / |b|^2, b(r) the windows' whitened responses
and P_b the projection off b: the variances of the field's slopes in u and r. Of the maxima one line is listed, the
highest. An array without extent along y is alike at all u: there are no maxima over u, and the densities are

    exp(-t)                                                 a cell, of a group of one bin
    sqrt(lambda) sqrt(t / pi) exp(-t)                       over r, of more

Only cells are fitted that are chosen for their power X over all C channels. In its own cell a line takes the share
g(r) = h(r)^2 / |b|^2 of its energy T, and has no slope in u: the rest of X is nearly of a Gamma distribution of shape
D = C - g - 1/2, so that a cell whose threshold is tau is chosen with probability Q(D, tau - g T), Q the upper tail. tau
itself is random: the largest of the other N - 1 cells of a range bin of N, or what OS-CFAR makes of the cells around
(:mod:`trainer.data.cfar`).

Beside a maximum of height T a lobe of the array whose correlation is rho has the field
rho sqrt(T) + CN(0, (1 - rho^2) / (1 - s)), s = -d log Q / d tau: the rest of a chosen cell is stronger than noise. The
lobe is higher with Marcum's probability Q_1, and kappa is the product over all lobes of what that leaves.

A frame of R range bins so lists

    R N E_e[ int int density(t) kappa(t + e) E_tau Q(D, tau - g (t + e)) du dr ],    e exponential

lines. Stored peaks of noise have no neighbour in their Doppler cell, if there is more than one: they are groups of one
bin. Left out: a choice among neighbouring Doppler cells, whose noise is alike. docs/notes/points.md measures how many
are listed.

Where elements of different TX that take turns coincide, a cell has K velocity intervals, and is turned back by the one
under which they agree best (:mod:`shared.signal.tdm`). A line of noise may stand under any of them, and one of energy T
is kept with the probability that T itself makes its interval the best.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaincc, gammainccinv
from scipy.stats import ncx2

from shared.radar import Radar
from shared.signal.tdm import most_coherent
from shared.signal.windows import hann_response, hann_slope
from trainer.data.cfar import cfar_thresholds
from trainer.estimators.array import LineArray, uniform_axis
from trainer.estimators.fitting import whitening

LEAST, MOST = 1.0, 700.0
"""Levels between which the answer is sought: LEAST_FALSE_ALARMS of :mod:`trainer.defaults` follow from about 600."""
LEVELS, VALID = np.arange(LEAST, 64.0), 0.8
"""Of levels that of which the equation has most lines: below, where a lobe of the array is higher nearly always, it has
few too. And the share of the most up to which it is taken."""
REACH_BINS, OWN_BINS = 1.5, 0.5
"""Lines of a group stand within: where cells are chosen, and where every bin's only cell is fitted."""
QUADRATURE = 16
"""Points of each expectation: with 64 the level is the same within 0.01."""
LOWER = 0.1
"""Of a threshold, over which s is a quotient of differences."""
LEAST_SHAPE = 1e-9
"""Of a Gamma distribution: a single channel has no rest."""
LOOKED_AT, DRAWN = np.arange(0.0, 61.0, 4.0), 400
"""Energies for which lines of noise are drawn under a cell's velocity intervals; and how many of each. One standard
error of a probability is 0.025 then at most, a tenth of those that count: so is the level's."""
LOBE_POINTS = 16
"""Angles in a resolution cell among which lobes are sought."""


def first_line_threshold(lines: float, radar: Radar, array: LineArray, every_cell: bool) -> float:
    """t, in units of the noise of one channel, that ``lines`` lines of a frame of noise pass.

    :param array: in which lines are fitted; cells are chosen by all channels of the radar
    :param every_cell: cells that pass OS-CFAR are fitted, else the strongest Doppler cell of each range bin
    """
    shape = radar.waveform.range_bins, radar.waveform.chirps
    seen, looks = radar.grid.bins * radar.grid.step, (1.0,) if every_cell else intervals_kept(radar)
    return _threshold(
        lines, shape, radar.array.channels, tuple(array.positions_m), array.wavelength_m, seen, every_cell, looks
    )


@lru_cache(maxsize=64)
def _threshold(
    lines: float,
    shape: tuple[int, int],
    channels: int,
    positions_m: tuple[float, ...],
    wavelength_m: float,
    seen: float,
    every_cell: bool,
    looks: tuple[float, ...],
) -> float:
    array = LineArray(np.array(positions_m), wavelength_m)
    flat = array.tells_no_angle
    slope = 1.0 if flat else 2.0 * np.pi / wavelength_m * float(np.std(array.positions_m)) * seen
    lobes = _lobes(array)
    beyond, share = np.polynomial.laguerre.laggauss(QUADRATURE)
    tau, likely = cfar_thresholds(shape, channels) if every_cell else strongest_of(shape[1], channels)
    grouped, reach = every_cell or shape[1] == 1, REACH_BINS if every_cell else OWN_BINS
    r, width = (reach * values for values in np.polynomial.legendre.leggauss(QUADRATURE))
    along, own = _group(r)
    if not grouped:
        along, own, width = np.ones((3, 1))

    def chosen(height: NDArray[np.float64], lower: float) -> NDArray[np.float64]:
        """[r, height] by how likely cells are, with thresholds lower by so much."""
        own_share = own[:, None, None]
        rest = np.maximum(tau - lower - own_share * height[:, None], 0.0)
        free = channels - own_share - (0.0 if flat else 0.5)
        return np.asarray(gammaincc(np.maximum(free, LEAST_SHAPE), rest) @ likely)

    def density(level: float) -> NDArray[np.float64]:
        """[r] of the maxima above a level, without exp(-level)."""
        if flat:
            return along * np.sqrt(level / np.pi) if grouped else along
        return along * ((2.0 * level - 1.0) / (2.0 * np.pi) if grouped else np.sqrt(level / np.pi))

    def excess(level: float) -> float:
        height = level + beyond
        maxima, more = ((density(level) * width) @ chosen(height, lower) for lower in (0.0, LOWER))
        if len(lobes):
            maxima = maxima * _highest(height, 1.0 / (1.0 - np.log(more / maxima) / LOWER), lobes)
        maxima = maxima * np.interp(height, LOOKED_AT[: len(looks)], looks)
        return float(np.log(shape[0] * shape[1] * slope * (maxima @ share) / lines) - level)

    # More than the equation has at any level: by exp(-t) from the level on at which it has VALID of its most.
    most = max(LEVELS, key=excess)
    held = min(excess(most) + float(np.log(VALID)), 0.0)
    return max(float(brentq(lambda level: excess(level) - held, most, MOST)) + held, LEAST)


@lru_cache(maxsize=8)
def intervals_kept(radar: Radar) -> tuple[float, ...]:
    """Of a cell's velocity intervals, under how many a line of noise of the energies ``LOOKED_AT`` is expected to be
    kept; 1 alone where all velocities are in one.

    By drawn noise, always the same, in which a line at any angle has the energy, in all channels of the radar. Left
    out: the slopes at its angle, and that an array of some of the channels sees a part of it.
    """
    if radar.velocity_intervals == 1:
        return (1.0,)
    channels, draw = radar.array.channels, np.random.default_rng(0)
    u = draw.uniform(-1.0, 1.0, (DRAWN, 1))
    line = np.exp(-2j * np.pi / radar.waveform.wavelength_m * u * radar.array.virtual[:, 1]) / np.sqrt(channels)
    noise = draw.standard_normal((DRAWN, channels, 2)) @ [np.sqrt(0.5), 1j * np.sqrt(0.5)]
    noise -= np.sum(noise * line.conj(), axis=1, keepdims=True) * line
    cells = noise + np.sqrt(LOOKED_AT)[:, None, None] * line
    kept = np.mean(most_coherent(cells, radar) == 0, axis=1)
    return tuple((radar.velocity_intervals * kept).tolist())


def strongest_of(cells: int, channels: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(tau [n], probabilities [n]): the largest power of the other cells of noise, summed over the channels."""
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE)
    if cells < 2:
        return np.zeros(1), np.ones(1)
    above = -np.expm1(np.log(0.5 * (nodes + 1.0)) / (cells - 1))
    return gammainccinv(channels, above), 0.5 * weights


def _group(r: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(sqrt(lambda) [n], g [n]) of a group of three bins at these offsets from its centre [bins]."""
    bins = np.array([-1, 0, 1])
    response = whitening(bins) @ hann_response(bins[:, None] - r)
    slope = -whitening(bins) @ hann_slope(bins[:, None] - r)
    energy = np.sum(response**2, axis=0)
    slope -= response * np.sum(slope * response, axis=0) / energy
    return np.sqrt(np.sum(slope**2, axis=0) / energy), hann_response(r) ** 2 / energy


def _lobes(array: LineArray) -> NDArray[np.float64]:
    """[n] |rho| of the array's lobes but the main one."""
    pattern = np.abs(array.manifold(uniform_axis(array, LOBE_POINTS)).mean(axis=0))
    peak = (pattern > np.roll(pattern, 1)) & (pattern >= np.roll(pattern, -1))
    peak[pattern.argmax()] = False
    return pattern[peak]


def _highest(
    height: NDArray[np.float64], power: NDArray[np.float64], lobes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """kappa [n] of maxima of these heights in cells whose rest has ``power`` [n].

    Q_1(a, b) is the upper tail of the noncentral chi-squared distribution of two degrees of freedom and noncentrality
    a^2 at b^2.
    """
    variance = np.maximum(1.0 - lobes**2, 1e-9)[:, None] * power
    higher = ncx2.sf(2.0 * height / variance, 2, 2.0 * lobes[:, None] ** 2 * height / variance)
    return np.asarray(np.prod(1.0 - higher, axis=0))
