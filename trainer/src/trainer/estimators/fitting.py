"""A joint fit of lines to every range bin, their number told by nobody.

The noise of the fit is the receiver's plus a share of the row's power for what the model leaves out: curved wave
fronts, calibration. A line stays where it lowers what is left by more than noise would anywhere with a stated
probability (a generalised likelihood-ratio test with known noise):

1. A row in which no angle stands out of the noise has no line, and costs nothing more.
2. The candidates that least squares needs are refined together.
3. The line whose removal, the others refined again, costs least is removed while it costs less than the threshold.
4. Where the energy left fails its chi-square test each line is split and one is added; the best is kept while it gains
   more than the threshold. Then step 3 again: an older line may have become needless.
5. In the place of one or two lines the best lone one is tried, of two and more the best pair elsewhere, of three to
   five also pairs beside each one: the lobes of a sparse array make optima that no small step leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2

from shared.physics.errors import InputError
from shared.signal.model_error import model_error_ratio, with_model_error
from trainer.estimators.array import LARGEST_RELATIVE_NOISE, LineArray, check_snapshots, row_powers, uniform_axis
from trainer.estimators.lines import STEPS, bounded_amplitudes, bounded_energy_left, line_covariance
from trainer.estimators.moves import additions, beside_lines, best_refit, pairs_elsewhere, refit, removals, splits

MODEL_ERROR_DB = -30.0
"""Of a row's power, of simulated data: the curvature of a wave front from 12 m over 94 mm leaves that much of one plane
wave. Captures have their own, see :mod:`shared.signal.model_error`."""
FALSE_ALARM = 1e-3
"""Probability that a row of noise alone gets a line: at most one in a frame of 630 rows."""
RESIDUAL_TAIL = 0.02
"""Probability that noise alone leaves so much energy that further lines are tried."""
MOST_LINES = 12
"""In a range bin, and at most half the channels."""
SEARCH_POINTS = 4
"""Angles in a resolution cell where lines are added."""
SPLIT_CELLS = (0.5, 0.2)
"""Distances of the two halves of a split line before they are refined, in resolution cells."""
ELSEWHERE = 3
"""Angles, and pairs of angles far from a row's lines, that are refined in their place."""
MOST_SEARCHED = 5
"""Lines of a row beside each of which pairs are tried."""
PRUNING_STEPS = 4
"""Gauss-Newton steps of a trial; what is kept is refined to the end."""
ROUNDING = 1e-20
"""Least noise of a fit, of the row's power: less is rounding."""


@dataclass(frozen=True, eq=False)
class FittedLines:
    """Lines of B rows, at most K in each, the strongest first; NaN angles and amplitudes of 0 where there is none.

    :param u: [B, K] sin(azimuth)
    :param amplitude: [B, K] complex [sqrt(W)]
    :param u_std: [B, K] standard deviations of u by the Cramer-Rao bound, at most the array's half period
    """

    u: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    u_std: NDArray[np.float64]


def fit_lines(
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    noise_power: float,
    candidates: NDArray[np.floating],
    model_error_db: float = MODEL_ERROR_DB,
    false_alarm: float = FALSE_ALARM,
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
    if np.isinf(candidates).any():
        raise InputError("candidates", "infinite angles", "finite angles, NaN for none")
    thermal = row_powers(noise_power, len(snapshots))
    model_error = max(model_error_ratio(model_error_db), ROUNDING)
    if not 0.0 < false_alarm < 1.0:
        raise InputError("false_alarm", repr(false_alarm), "a probability between 0 and 1")
    rows = np.asarray(snapshots, dtype=np.complex128)
    scale = np.abs(rows).max(axis=1, initial=0.0)
    present = np.flatnonzero(scale > 0.0)
    x = rows[present] / scale[present, None]
    # The quotient comes before the square: the square of 1e-200 would be zero.
    relative = np.minimum(np.sqrt(thermal[present]) / scale[present], LARGEST_RELATIVE_NOISE) ** 2
    power = np.mean(np.abs(x) ** 2, axis=1)
    noise = with_model_error(relative, power, model_error)
    fit = _Fit(x, array, noise, false_alarm)
    heard = fit.above_noise()
    fit.begin(heard, np.asarray(candidates, dtype=np.float64)[present])
    fit.prune(heard)
    fit.settle(heard)
    fit.grow(heard)
    fit.look_elsewhere(heard)
    u, amplitude, u_std = fit.finish(heard)
    found = FittedLines(
        np.full((len(rows), fit.most), np.nan),
        np.zeros((len(rows), fit.most), dtype=np.complex128),
        np.full((len(rows), fit.most), np.nan),
    )
    found.u[present], found.u_std[present] = u, u_std
    found.amplitude[present] = amplitude * scale[present, None]
    return found


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


class _Fit:
    """Lines of B rows while they are fitted: angles [B, K] of which the first ``count`` [B] are in use.

    :param x: [B, C] snapshots of largest element 1
    :param noise: [B] noise power of the fit, in their scale
    """

    def __init__(
        self, x: NDArray[np.complex128], array: LineArray, noise: NDArray[np.float64], false_alarm: float
    ) -> None:
        self.x, self.array, self.noise = x, array, noise
        self.most = max(min(MOST_LINES, array.channels // 2), 1)
        self.threshold = line_threshold(array, false_alarm)
        self.axis = uniform_axis(array, SEARCH_POINTS)
        self.u = np.full((len(x), self.most), np.nan)
        self.count = np.zeros(len(x), dtype=np.intp)
        self.left = np.sum(np.abs(x) ** 2, axis=1)

    def above_noise(self) -> NDArray[np.intp]:
        """Rows in which the best angle takes more than the threshold."""
        explained = beside_lines(self.x, self.array, self.axis, np.empty((len(self.x), 0)))[0]
        # Half a step off the grid a lone line loses 0.1 dB.
        return np.flatnonzero(explained.max(axis=1, initial=0.0) > self.threshold * self.noise)

    def begin(self, rows: NDArray[np.intp], candidates: NDArray[np.float64]) -> None:
        """The candidates that least squares on their angles needs, at least one, refined."""
        given = np.sort(np.isnan(candidates), axis=1)
        order = np.argsort(np.isnan(candidates), axis=1, kind="stable")
        ordered = np.take_along_axis(candidates, order, axis=1)[:, : self.most]
        count = np.minimum(np.count_nonzero(~given, axis=1), self.most)
        self.u[rows, : ordered.shape[1]] = ordered[rows]
        self.count[rows] = count[rows]
        without = rows[count[rows] == 0]
        if len(without):
            self.u[without, :1] = additions(self.x[without], self.array, self.axis, np.empty((len(without), 0)))[:, 0]
            self.count[without] = 1
        going = rows
        while len(going):
            going = going[self.count[going] > 1]
            going = np.concatenate([*self._grouped(going, self._drop_by_least_squares), going[:0]])
        self._grouped(rows, self._settle_a_little)

    def prune(self, rows: NDArray[np.intp]) -> None:
        """Remove lines, the others refined again, while the cheapest one gains less than the threshold."""
        going = rows
        while len(going):
            going = np.concatenate([*self._grouped(going, self._drop_with_refit), going[:0]])

    def settle(self, rows: NDArray[np.intp]) -> None:
        """Refine the lines to the end."""
        self._grouped(rows, self._refine)

    def grow(self, rows: NDArray[np.intp]) -> None:
        """Split or add lines while the energy left fails its test and the best trial gains; prune what has grown."""
        going, grown = rows, rows[:0]
        while len(going):
            going = np.concatenate([*self._grouped(going, self._split_or_add), going[:0]])
            grown = np.union1d(grown, going)
        self.prune(grown)

    def look_elsewhere(self, rows: NDArray[np.intp]) -> None:
        """Other lines in the place of those found, as many or fewer, where that costs less."""
        self._grouped(rows[self.count[rows] <= 2], self._try_lone)
        self._grouped(rows[self.count[rows] > 1], self._try_pair)

    def finish(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.float64]]:
        """(u, amplitude, u_std) [B, K], strongest first."""
        u, u_std = np.full(self.u.shape, np.nan), np.full(self.u.shape, np.nan)
        amplitude = np.zeros(self.u.shape, dtype=np.complex128)
        self.settle(rows)
        half = self.array.half_period
        for group, count in self._groups(rows):
            found = self.u[group, :count]
            strength = bounded_amplitudes(self.x[group], found, self.array)[0]
            variance = np.diagonal(
                line_covariance(self.x[group], found, self.array, self.noise[group]), axis1=1, axis2=2
            )
            order = np.argsort(-np.abs(strength), axis=1, kind="stable")
            found = (found + half) % (2.0 * half) - half if half < 1.0 else np.clip(found, -1.0, 1.0)
            deviation = np.minimum(np.sqrt(np.maximum(variance, 0.0)), half)
            for target, values in ((u, found), (amplitude, strength), (u_std, deviation)):
                target[group, :count] = np.take_along_axis(values, order, axis=1)
        return u, amplitude, u_std

    def _groups(self, rows: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], int]]:
        for count in np.unique(self.count[rows]):
            if count:
                yield rows[self.count[rows] == count], int(count)

    def _grouped(
        self, rows: NDArray[np.intp], change: Callable[[NDArray[np.intp], int], NDArray[np.intp]]
    ) -> list[NDArray[np.intp]]:
        """``change`` of the rows of each number of lines; the rows that it has changed."""
        return [change(group, count) for group, count in list(self._groups(rows))]

    def _settle_a_little(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        return self._refine(rows, count, PRUNING_STEPS)

    def _refine(self, rows: NDArray[np.intp], count: int, steps: int = STEPS) -> NDArray[np.intp]:
        lines, left = refit(self.x[rows], self.u[rows, :count], self.array, steps, bounded_energy_left)
        self._put(rows, lines, left)
        return rows

    def _drop_by_least_squares(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Rows that lost the line whose absence costs least at these angles."""
        x, lines = self.x[rows], self.u[rows, :count]
        trials = removals(lines)
        energy = bounded_energy_left(
            np.repeat(x, count, axis=0), trials.reshape(len(rows) * count, count - 1), self.array
        ).reshape(len(rows), count)
        cost = energy.min(axis=1) - bounded_energy_left(x, lines, self.array)
        needless = cost < self.threshold * self.noise[rows]
        least = np.argmin(energy, axis=1)
        self._put(rows[needless], trials[needless, least[needless]], energy.min(axis=1)[needless])
        return rows[needless]

    def _drop_with_refit(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        trials = removals(self.u[rows, :count])
        if count == 1:
            lines, left = trials[:, 0], np.sum(np.abs(self.x[rows]) ** 2, axis=1)
        else:
            lines, left = best_refit(self.x[rows], trials, self.array, PRUNING_STEPS, bounded_energy_left)
        needless = left - self.left[rows] < self.threshold * self.noise[rows]
        self._put(rows[needless], lines[needless], left[needless])
        return rows[needless]

    def _split_or_add(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        channels = self.array.channels
        freedom = 2 * channels - 3 * count
        if count >= self.most or freedom <= 0:
            return rows[:0]
        rows = rows[self.left[rows] > 0.5 * chi2.ppf(1.0 - RESIDUAL_TAIL, freedom) * self.noise[rows]]
        if not len(rows):
            return rows
        x, lines = self.x[rows], self.u[rows, :count]
        distances = [cells * self.array.resolution_cell for cells in SPLIT_CELLS]
        trials = np.concatenate([additions(x, self.array, self.axis, lines), splits(lines, distances)], axis=1)
        best, left = best_refit(x, trials, self.array, measure=bounded_energy_left)
        gains = self.left[rows] - left > self.threshold * self.noise[rows]
        self._put(rows[gains], best[gains], left[gains])
        return rows[gains]

    def _try_lone(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """The angle that explains most in place of all: a peak that the fit began with may be a sidelobe's."""
        self._replace(rows, additions(self.x[rows], self.array, self.axis, np.empty((len(rows), 0)), ELSEWHERE))
        return rows

    def _try_pair(self, rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Two lines in place of all, or one of a few kept and two beside it."""
        lines = self.u[rows, :count]
        # Where a line fewer would do, the best pair may stand near the lines.
        self._replace_by_pair(rows, lines[:, :0], lines if count == 2 else lines[:, :0])
        if 2 < count <= MOST_SEARCHED:
            for line in range(count):
                going = self.count[rows] == count
                self._replace_by_pair(rows[going], lines[going, line : line + 1], lines[going, :0])
        return rows

    def _replace_by_pair(self, rows: NDArray[np.intp], kept: NDArray[np.float64], avoided: NDArray[np.float64]) -> None:
        """Try the best pair beside the lines ``kept`` in the place of a row's others."""
        self._replace(rows, pairs_elsewhere(self.x[rows], self.array, self.axis, kept, avoided, ELSEWHERE))

    def _replace(self, rows: NDArray[np.intp], trials: NDArray[np.float64]) -> None:
        """Put the best of ``trials`` [B, T, K] in the place of a row's lines where it costs less."""
        best, left = best_refit(self.x[rows], trials, self.array, PRUNING_STEPS, bounded_energy_left)
        fewer = self.count[rows] - best.shape[1]
        better = left < self.left[rows] + fewer * self.threshold * self.noise[rows]
        self._put(rows[better], best[better], left[better])

    def _put(self, rows: NDArray[np.intp], lines: NDArray[np.float64], left: NDArray[np.float64]) -> None:
        self.u[rows] = np.nan
        self.u[rows, : lines.shape[1]] = lines
        self.count[rows] = lines.shape[1]
        self.left[rows] = left
