"""A joint fit of lines to every range bin, their number told by nobody.

The noise of the fit is the receiver's plus a share of the row's power for what the model leaves out: curved wave
fronts, calibration. How a row is fitted stands in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaincinv

from shared.physics.errors import InputError
from shared.signal.model_error import model_error_ratio, with_model_error
from shared.signal.windows import hann_correlation, hann_response, hann_slope
from trainer.estimators.array import LARGEST_RELATIVE_NOISE, LineArray, check_snapshots, row_powers, uniform_axis
from trainer.estimators.group_products import MOST_CELLS, POINTS_A_BIN, TABLE_BINS, Model
from trainer.estimators.groups import fit_in_turn

MODEL_ERROR_DB = -30.0
"""Of a row's power, of simulated data: the curvature of a wave front from 12 m over 94 mm leaves that much of one plane
wave. Captures have their own, see :mod:`shared.signal.model_error`."""
FALSE_ALARM = 1e-3
"""Probability that a row of noise alone gets a line: at most one in a frame of 630 rows."""
RESIDUAL_TAIL = 0.02
"""Probability that noise alone leaves so much energy that further lines are tried."""
RESPONSE_BINS = 4
"""How far a window's response is told: beyond, a Hann window's is below -48 dB."""
MOST_LINES = 12
"""In a range bin, and at most half the channels."""
SEARCH_POINTS = 4
"""Angles in a resolution cell where lines are added."""
SHARE = 16
"""Groups that a thread fits at a time: some milliseconds."""
ROUNDING = 1e-14
"""Least noise of a fit, of the row's power: less is rounding."""


@dataclass(frozen=True, eq=False)
class FittedLines:
    """Lines of B groups of range bins, at most K in each, the strongest first; where there is none NaN and amplitude 0.

    :param u: [B, K] sin(azimuth); 0 of an array that tells no angle
    :param amplitude: [B, K] complex [sqrt(W)]
    :param u_std: [B, K] standard deviations of u by the Cramer-Rao bound, at most the array's half period
    :param offset: [B, K] from the group's centre [bins], 0 where a group is one cell
    :param offset_std: [B, K] its standard deviation by the Cramer-Rao bound, NaN where a group is one cell
    """

    u: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    u_std: NDArray[np.float64]
    offset: NDArray[np.float64]
    offset_std: NDArray[np.float64]


def fit_lines(
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    noise_power: float,
    candidates: NDArray[np.floating],
    model_error_db: float = MODEL_ERROR_DB,
) -> FittedLines:
    """The lines of every row.

    :param snapshots: [B, C] [sqrt(W)]
    :param noise_power: of one channel [W]
    :param candidates: [B, K] angles to begin with, the most likely first, NaN for none; K may be 0
    :param model_error_db: power that no line explains, of the row's power [dB]; -inf for none
    :raises InputError: shapes that do not fit, snapshots or powers that are not finite
    """
    check_snapshots(snapshots, array)
    if np.ndim(candidates) != 2 or len(candidates) != len(snapshots):
        raise InputError("candidates", f"shape {np.shape(candidates)}", f"[{len(snapshots)} range bins, any number]")
    # Groups of one bin, so far away that waves are flat and no echo walks from bin to bin.
    far = RangePlace(np.full(len(snapshots), np.inf), np.inf)
    threshold = line_threshold(array, FALSE_ALARM)
    test = GroupTest(noise_power, model_error_db, threshold, threshold)
    return fit_groups(snapshots[:, None], np.zeros(1, dtype=np.int64), array, far, candidates, test)


@dataclass(frozen=True, eq=False)
class RangePlace:
    """Where groups stand in range.

    :param centre_m: [B] range of each group's centre, above 0
    :param step_m: of a bin
    :param migration: [B] bins through which an echo may migrate while the frame is recorded; None for none
    """

    centre_m: NDArray[np.float64]
    step_m: float
    migration: NDArray[np.float64] | None = None

    def walk(self, array: LineArray) -> NDArray[np.float64]:
        """[C] w_c, by which an echo at u = 1 is displaced in each channel [bins], from the middle of the array: what is
        common to all channels would carry lines of an array beside the origin out of their groups."""
        return 0.5 * (array.positions_m - array.positions_m.mean()) / self.step_m


@dataclass(frozen=True)
class GroupTest:
    """What a line of a group has to stand out of.

    :param noise_power, model_error_db: as of :func:`fit_lines`
    :param first, further: energies that a group's first line and every other one must take, in units of the noise
    """

    noise_power: float
    model_error_db: float
    first: float
    further: float


def fit_groups(
    cells: NDArray[np.complexfloating],
    bins: NDArray[np.integer],
    array: LineArray,
    place: RangePlace,
    candidates: NDArray[np.floating],
    test: GroupTest,
) -> FittedLines:
    """The lines of groups of range bins of Hann windowed spectra, each group fitted as one.

    :param cells: [B, M, C] of one Doppler cell [sqrt(W)], straightened for u = 0: see :mod:`trainer.estimators.array`
    :param bins: [M] of each cell from the group's centre, 0 among them
    :param candidates: as of :func:`fit_lines`
    """
    cells, bins = np.asarray(cells, np.complex128), np.asarray(bins, np.int64)
    model = _model(array, bins, test.first, test.further, place)
    thermal = row_powers(test.noise_power, len(cells))
    white = whitening(bins)
    whitened = np.einsum("mn,bnc->bmc", white * alternating(bins), cells)
    scale = np.abs(whitened).max(axis=(1, 2), initial=0.0)
    present = np.flatnonzero(scale > 0.0)
    x = np.zeros((len(present), MOST_CELLS, array.channels), dtype=np.complex128)
    x[:, : len(bins)] = whitened[present] / scale[present, None, None]
    # The quotient comes before the square: the square of 1e-200 would be zero.
    relative = np.minimum(np.sqrt(thermal[present]) / scale[present], LARGEST_RELATIVE_NOISE) ** 2
    power = np.mean(np.abs(cells[present] / scale[present, None, None]) ** 2, axis=2).max(axis=1, initial=0.0)
    noise = with_model_error(relative, power, max(model_error_ratio(test.model_error_db), ROUNDING))
    found = np.full((len(x), model.most, 2), np.nan)
    amplitude, deviation = np.zeros(found.shape[:2], dtype=np.complex128), np.full(found.shape, np.nan)
    given = np.ascontiguousarray(candidates, dtype=np.float64)[present]
    parts = np.ascontiguousarray(np.stack([x.real, x.imag], axis=1))
    migration = np.zeros(len(cells)) if place.migration is None else place.migration
    scales = np.stack([noise, 1.0 / place.centre_m[present], migration[present]], axis=1)

    def fit_share(first: int) -> None:
        some = slice(first, first + SHARE)
        fit_in_turn(model, parts[some], scales[some], given[some], found[some], amplitude[some], deviation[some])

    with ThreadPoolExecutor(numba.config.NUMBA_NUM_THREADS) as pool:
        list(pool.map(fit_share, range(0, len(x), SHARE)))
    order = np.argsort(-np.abs(amplitude), axis=1, kind="stable")
    u, half = found[..., 0], array.half_period
    found[..., 0] = (u + half) % (2.0 * half) - half if half < 1.0 else np.clip(u, -1.0, 1.0)
    if array.tells_no_angle:
        found[..., 0] *= 0.0  # whatever the fit began at
    deviation[..., 0] = np.minimum(deviation[..., 0], half)

    def all_groups(values: NDArray, empty: float) -> NDArray:
        out = np.full((len(cells), model.most), empty, dtype=values.dtype)
        out[present] = np.take_along_axis(values, order, axis=1)
        return out

    strength = all_groups(amplitude * scale[present, None], 0.0)
    return FittedLines(
        all_groups(found[..., 0], np.nan), strength, all_groups(deviation[..., 0], np.nan),
        all_groups(found[..., 1], np.nan), all_groups(deviation[..., 1], np.nan),
    )  # fmt: skip


def alternating(bins: NDArray[np.integer]) -> NDArray[np.float64]:
    """[M] signs of a Hann window's response at whole bins, which change from one to the next."""
    return np.asarray(1.0 - 2.0 * (bins % 2))


def whitening(bins: NDArray[np.integer]) -> NDArray[np.float64]:
    """[M, M] inverse of the Cholesky factor of the noise of these bins, after which least squares is likeliest."""
    return np.linalg.inv(np.linalg.cholesky(hann_correlation(bins[:, None] - bins)))


def _response_table(bins: NDArray[np.integer]) -> NDArray[np.float64]:
    """The whitened responses of cells at these bins as :class:`trainer.estimators.group_products.Model` has them."""
    x = np.arange(-TABLE_BINS * POINTS_A_BIN, TABLE_BINS * POINTS_A_BIN + 2) / POINTS_A_BIN
    value, rise = hann_response(x - bins[:, None]), hann_slope(x - bins[:, None]) / POINTS_A_BIN
    step = np.diff(value)
    low, high = rise[:, :-1], rise[:, 1:]
    cubic = np.stack([value[:, :-1], low, 3.0 * step - 2.0 * low - high, low + high - 2.0 * step])
    cubic *= np.abs(x[:-1] + 0.5 / POINTS_A_BIN - bins[:, None]) < RESPONSE_BINS
    table = np.zeros((len(x) - 1, 4, MOST_CELLS))
    table[..., : len(bins)] = np.einsum("mn,pnx->xpm", whitening(bins), cubic)
    return table


def _model(array: LineArray, bins: NDArray[np.integer], first: float, further: float, place: RangePlace) -> Model:
    """What the compiled fit is told of an array; thresholds in units of the noise."""
    most = max(min(MOST_LINES, array.channels // 2), 1)
    axis = uniform_axis(array, SEARCH_POINTS)
    steering = array.manifold(axis)
    freedom = 2 * array.channels * len(bins) - (3 if len(bins) == 1 else 4) * np.arange(most + 1)
    limit = np.where(freedom > 0, gammaincinv(0.5 * np.maximum(freedom, 1), 1.0 - RESIDUAL_TAIL), np.inf)
    return Model(
        phase=2.0 * np.pi / array.wavelength_m * array.positions_m,
        walk=place.walk(array),
        curve=array.bend_phase(np.ones(1))[0],
        window=_response_table(bins),
        cells=len(bins),
        cell=array.resolution_cell,
        axis=axis,
        steering=np.ascontiguousarray([steering.real, steering.imag]),
        overlap=array.manifold((axis[1] - axis[0]) * np.arange(len(axis))).mean(axis=0),
        first=first,
        further=further,
        limit=limit,
        most=most,
    )


def line_threshold(array: LineArray, false_alarm: float) -> float:
    """Energy, in units of the noise power, that the best line takes of noise with probability ``false_alarm``.

    At one angle it is above t with probability exp(-t); over one period Delta u of u the expected number of upcrossings
    (Rice 1944) is Delta u beta sqrt(t / pi) exp(-t), beta = k std(p). The sum of both bounds the probability.
    """
    beta = 2.0 * np.pi / array.wavelength_m * float(np.std(array.positions_m))
    curve = 2.0 * array.half_period * beta / np.sqrt(np.pi)

    def excess(level: float) -> float:
        return float(np.log1p(curve * np.sqrt(level)) - level - np.log(false_alarm))

    # The probability rises and then falls: the level sought is on the falling side.
    return float(brentq(excess, 0.5, 1000.0)) if excess(0.5) > 0.0 else 0.5


def score_peaks(score: NDArray[np.floating], u: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """[B, count] angles of the largest local maxima of each row of a score [B, U], largest first; NaN for none.

    A parabola through three bins places each; the first and the last bin count as maxima where they are the largest of
    their two.
    """
    values, axis = np.asarray(score, dtype=np.float64), np.asarray(u, dtype=np.float64)
    padded = np.pad(values, ((0, 0), (1, 1)))
    before, after = padded[:, :-2], padded[:, 2:]
    height = np.where((values > before) & (values >= after) & (values > 0.0), values, 0.0)
    best = np.argsort(-height, axis=1, kind="stable")[:, :count]
    row = np.arange(len(values))[:, None]
    middle, left, right = values[row, best], before[row, best], after[row, best]
    bend = 2.0 * middle - left - right
    inner = (best > 0) & (best < len(axis) - 1) & (bend > 0.0)
    shift = np.where(inner, 0.5 * (right - left) / np.where(inner, bend, 1.0), 0.0)
    found = np.interp(best + shift, np.arange(len(axis)), axis)
    found[height[row, best] <= 0.0] = np.nan
    if found.shape[1] < count:
        found = np.pad(found, ((0, 0), (0, count - found.shape[1])), constant_values=np.nan)
    return found
