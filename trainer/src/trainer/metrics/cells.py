"""Detections in range and angle, each with a score and a level, held against the cells of the truth image.

A truth cell is a 3 x 3 maximum of the truth image that the channels can see above the noise and beside the row's
strongest echo. A detection is a 3 x 3 maximum of a method's score. It is matched to a truth cell at most one range bin
and two angle bins away, one to one. An unmatched detection beyond 5 m is a false alarm where it reads more than 10 dB
above all that the truth has around it; elsewhere it counts neither way.

The level must be right: an image that reads far too low everywhere has no false alarms.

Many frames are ranked in the order of their detections' scores (:class:`Ranking`): average precision, detection
probability at false alarms. One threshold holds for all of them. Detections of equal score are above a threshold
together or not at all, so that their order changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter, mean

from shared.physics.errors import InputError
from shared.physics.units import db_to_amplitude, db_to_power
from trainer.metrics.bootstrap import UNDEFINED, Interval, bootstrap_frames

LEAST_SNR_DB = 13.0
"""C |A|^2 / noise_power of a truth cell: with all channels summed a single target is found nearly always."""
ROW_SPAN_DB = 25.0
"""A truth cell stands at most this far below its row's maximum; the truth's own sidelobes lie at -30 dB."""
LEAST_RANGE_M = 5.0
"""Nearer waves are curved over the input array, and no method is told so: there nothing is missed and nothing false."""
REACH = (1, 2)
"""Largest distance of a detection from its truth cell [range bins, angle bins]."""
FALSE_ALARM_DB = 10.0
"""Level of a false alarm above the truth's maximum within that reach, at least."""

_AROUND = (2 * REACH[0] + 1, 2 * REACH[1] + 1)


@dataclass(frozen=True, eq=False)
class CellScores:
    """What became of the detections of one frame.

    :param matched: [m] scores of the detections that found a truth cell, falling
    :param false_alarms: [f] scores of the false alarms, falling
    """

    matched: NDArray[np.float64]
    false_alarms: NDArray[np.float64]
    truths: int


def local_maxima(magnitude: NDArray[np.floating]) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the positive 3 x 3 maxima of an image [R, U], row by row.

    A plateau is one maximum, at the bin next to its mean place. A bin at the image's border needs to exceed only the
    neighbours that it has.
    """
    # The highest along a row first: what reaches that of the three rows around it is the highest of nine.
    highest = magnitude.copy()
    np.maximum(highest[:, 1:], magnitude[:, :-1], out=highest[:, 1:])
    np.maximum(highest[:, :-1], magnitude[:, 1:], out=highest[:, :-1])
    top = (magnitude == highest) & (magnitude > 0.0)
    top[1:] &= magnitude[1:] >= highest[:-1]
    top[:-1] &= magnitude[:-1] >= highest[1:]
    return _one_of_each_plateau(top)


def truth_cells(image: NDArray[np.floating], noise_power: float, channels: int, range_step: float) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the cells that a method of ``channels`` channels should find, row by row.

    They are those of :func:`visible_cells` beyond 5 m.

    :param range_step: of the rows, the first of which is at 0 [m]
    """
    places = visible_cells(image, noise_power, channels)
    return places[places[:, 0] * range_step > LEAST_RANGE_M]


def visible_cells(image: NDArray[np.floating], noise_power: float, channels: int) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the maxima that ``channels`` channels can see, at any range, row by row.

    They are the 3 x 3 maxima A of the truth with C |A|^2 / noise_power above 13 dB, within 25 dB of their row's
    maximum.

    :param image: [R, U] truth, linear magnitude [sqrt(W)]
    :param noise_power: of one channel in one range-Doppler cell [W]; 0 where there is no noise
    :param channels: C, how many the method uses
    :raises InputError: no image, or one that is not finite
    """
    magnitude = _image("truth", image)
    least = np.sqrt(db_to_power(LEAST_SNR_DB) * noise_power / channels)
    places = local_maxima(magnitude)
    level = magnitude[places[:, 0], places[:, 1]]
    within = level >= db_to_amplitude(-ROW_SPAN_DB) * magnitude.max(axis=1, initial=0.0)[places[:, 0]]
    return places[(level > least) & within]


def score_cells(
    truth: NDArray[np.floating],
    level: NDArray[np.floating],
    noise_power: float,
    channels: int,
    range_step: float,
    score: NDArray[np.floating] | None = None,
) -> CellScores:
    """Hold a method's image against the truth of its frame.

    At every threshold of the score the matched detections above it are as many as one-to-one matching allows: a
    detection of lower score never takes a truth cell from one of higher score, but the latter moves to another cell
    within its own reach if that makes room (augmenting paths, Kuhn 1955). Of detections of equal score those that
    would else be false alarms are matched first. So neither the cell that a detection is tried with first nor the order
    of equal scores changes anything.

    :param truth: [R, U] linear magnitude [sqrt(W)]
    :param level: [R, U] the method's magnitude [sqrt(W)]. It alone says what is a false alarm, so that an image
        without this unit cannot stand here
    :param noise_power: see :func:`truth_cells`, as ``channels`` and ``range_step``
    :param score: [R, U] by which detections are found and ranked, in any unit; the level by default
    :raises InputError: images of different shapes or not finite, and what :func:`truth_cells` refuses
    """
    true, reading = _image("truth", truth), _image("level", level)
    ranking = reading if score is None else _image("score", score)
    if not true.shape == reading.shape == ranking.shape:
        raise InputError("images", f"shapes {true.shape}, {reading.shape}, {ranking.shape}", "images of one shape")
    cells = truth_cells(true, noise_power, channels, range_step)
    found = local_maxima(ranking)
    rows, bins = found.T
    rank = ranking[rows, bins]
    ceiling = db_to_amplitude(FALSE_ALARM_DB) * maximum_filter(true, _AROUND, mode="constant")
    alarm = (reading[rows, bins] > ceiling[rows, bins]) & (rows * range_step > LEAST_RANGE_M)
    order = np.lexsort((~alarm, -rank))
    found, rank, alarm = found[order], rank[order], alarm[order]
    matched = match_cells(found, cells, true.shape)
    return CellScores(rank[matched], rank[alarm & ~matched], len(cells))


def match_cells(found: NDArray[np.intp], cells: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """[n] which detections [n, 2], best first, have a truth cell [m, 2] within :data:`REACH` to themselves."""
    cell_at = np.full((shape[0] + 2 * REACH[0], shape[1] + 2 * REACH[1]), -1)
    cell_at[cells[:, 0] + REACH[0], cells[:, 1] + REACH[1]] = np.arange(len(cells))
    windows = sliding_window_view(cell_at, _AROUND)
    near = windows[found[:, 0], found[:, 1]].reshape(len(found), _AROUND[0] * _AROUND[1])
    served: dict[int, int] = {}  # cell to detection
    holds: dict[int, int] = {}  # detection to cell
    full: set[int] = set()  # cells from which no way leads to a free one, now and later

    def find_room(detection: int) -> bool:
        reached: dict[int, int] = {}  # cell to the detection that could take it
        queue = [detection]
        for one in queue:
            for cell in near[one].tolist():
                if cell < 0 or cell in reached or cell in full:
                    continue
                reached[cell] = one
                if cell in served:
                    queue.append(served[cell])
                    continue
                free: int | None = cell
                while free is not None:
                    taker = reached[free]
                    left = holds.get(taker)
                    served[free], holds[taker] = taker, free
                    free = left
                return True
        full.update(reached)
        return False

    matched = np.zeros(len(found), dtype=bool)
    for detection in np.flatnonzero(near.max(axis=1, initial=-1) >= 0).tolist():
        matched[detection] = find_room(detection)
    return matched


def _one_of_each_plateau(top: NDArray[np.bool_]) -> NDArray[np.intp]:
    """[n, 2] places of a mask [R, U], one for each group of adjacent bins."""
    places = np.argwhere(top)
    around = np.pad(top, 1)
    rows, bins = places.T + 1
    if not any(around[rows + down, bins + aside].any() for down, aside in ((0, 1), (1, -1), (1, 0), (1, 1))):
        return places
    groups, count = label(top, np.ones((3, 3)))
    of_place = groups[places[:, 0], places[:, 1]]
    every = np.arange(1, count + 1)
    middle = np.stack([mean(places[:, axis], of_place, every) for axis in (0, 1)], axis=1)
    distance = np.sum((places - middle[of_place - 1]) ** 2, axis=1)
    nearest = np.lexsort((distance, of_place))
    chosen = nearest[np.searchsorted(of_place[nearest], every)]
    return places[np.sort(chosen)]


def _image(name: str, image: NDArray[np.floating]) -> NDArray[np.float64]:
    magnitude = np.asarray(image, dtype=np.float64)
    if magnitude.ndim != 2 or not np.isfinite(magnitude).all():
        raise InputError(name, f"shape {magnitude.shape}, finite or not", "a finite image [R, U]")
    return magnitude


LEVELS = 2000
"""Thresholds, of those at which a detection matched, that a drawn pool is evaluated at; its value has all of them."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """Matched detections and false alarms of all frames, in the order of falling score.

    :param truths: [frames] truth cells of each frame
    :param frame: [n] of each detection
    :param matched: [n] True for a matched detection, False for a false alarm
    :param last: [g] the last detection of each score
    """

    truths: NDArray[np.float64]
    frame: NDArray[np.intp]
    matched: NDArray[np.bool_]
    last: NDArray[np.intp]

    @property
    def defined(self) -> bool:
        """There is something to detect."""
        return bool(self.truths.sum() > 0)

    def average_precision(self) -> float:
        """Sum over the scores, falling, of the gain in detection probability times the precision there; NaN without
        truth cells.

        The precision is M / (M + F) of the M matched detections and F false alarms of at least that score.
        """
        return float(self.values(())[0])

    def values(self, false_alarms: Sequence[float]) -> NDArray[np.float64]:
        """[1 + false_alarms] the average precision, then for each number of false alarms a frame the share of the truth
        cells that is detected at the lowest threshold of at most as many; NaN without truth cells."""
        if not self.defined:
            return np.full(1 + len(false_alarms), np.nan)
        matched, false = self._counts()
        return _scores(matched[None], false[None], self.truths.sum()[None], len(self.truths), false_alarms)[:, 0]

    def curve(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([g] false alarms a frame, [g] detection probability) at each score, falling; empty without truth cells."""
        if not self.defined:
            return np.empty(0), np.empty(0)
        matched, false = self._counts()
        return false / len(self.truths), matched / self.truths.sum()

    def intervals(self, false_alarms: Sequence[float], seed: int = 0) -> list[Interval]:
        """:meth:`values` with their intervals over the frames."""
        values = self.values(false_alarms)
        frames = len(self.truths)
        if not self.defined:
            return [UNDEFINED for _ in values]
        ends = bootstrap_frames(self._of_draws(false_alarms), frames, seed)
        return [Interval(float(value), *end) for value, end in zip(values, ends, strict=True)]

    def _of_draws(self, false_alarms: Sequence[float]) -> Callable[[NDArray[np.int64]], NDArray[np.float64]]:
        """What takes how often each frame was drawn, [B, frames], to the values of these draws, [1 + false_alarms, B].

        Of a ranking with truth cells.
        """
        matched, false = self._counts_of_frames()

        def values(weights: NDArray[np.int64]) -> NDArray[np.float64]:
            drawn = weights.astype(np.float64)
            return _scores(drawn @ matched, drawn @ false, drawn @ self.truths, len(self.truths), false_alarms)

        return values

    def _counts(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([g] matched detections, [g] false alarms) down to each score."""
        matched = np.cumsum(self.matched)[self.last].astype(np.float64)
        return matched, self.last + 1.0 - matched

    def _counts_of_frames(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same for each frame alone, [frames, levels], down to scores at which a detection matched."""
        useful = self.last[np.diff(self._counts()[0], prepend=0.0) > 0.0]
        count = min(len(useful), LEVELS)
        levels = useful[np.linspace(0, len(useful) - 1, count).round().astype(np.intp)]
        of_level = np.searchsorted(levels, np.arange(len(self.frame)))
        place = self.frame * (count + 1) + of_level  # what comes after the last level has one of its own

        def down_to_level(kind: NDArray[np.bool_]) -> NDArray[np.float64]:
            counts = np.bincount(place[kind], minlength=len(self.truths) * (count + 1))
            return np.cumsum(counts.reshape(-1, count + 1), axis=1)[:, :count].astype(np.float64)

        return down_to_level(self.matched), down_to_level(~self.matched)


def pooled(frames: Sequence[CellScores]) -> Ranking:
    """The frames, one or more, in one ranking."""
    score = np.concatenate([part for one in frames for part in (one.matched, one.false_alarms)])
    sizes = np.array([(len(one.matched), len(one.false_alarms)) for one in frames])
    frame = np.repeat(np.arange(len(frames)), sizes.sum(axis=1))
    matched = np.repeat(np.tile([True, False], len(frames)), sizes.ravel())
    order = np.argsort(-score, kind="stable")
    falling = score[order]
    last = np.flatnonzero(np.append(falling[1:] != falling[:-1], True)[: len(falling)])
    truths = np.array([one.truths for one in frames], dtype=np.float64)
    return Ranking(truths, frame[order], matched[order], last)


def average_precision(ranking: Ranking, less: Ranking | None = None, seed: int = 0) -> Interval:
    """Average precision of a method, less that of another on the same frames, with its interval.

    The frames are drawn again for both together, so that what a hard frame costs both is not counted as a difference:
    the interval of a difference is as a rule much narrower than those of the two numbers.
    """
    if less is None:
        return ranking.intervals((), seed)[0]
    if not ranking.defined:
        return UNDEFINED
    of_ranking, of_less = ranking._of_draws(()), less._of_draws(())
    (ends,) = bootstrap_frames(lambda weights: of_ranking(weights) - of_less(weights), len(less.truths), seed)
    return Interval(ranking.average_precision() - less.average_precision(), *ends)


def _scores(
    matched: NDArray[np.float64],
    false: NDArray[np.float64],
    truths: NDArray[np.float64],
    frames: int,
    false_alarms: Sequence[float],
) -> NDArray[np.float64]:
    """[1 + len(false_alarms), B] average precision and detection probabilities of counts [B, g] and truths [B]."""
    # A drawn pool without truth cells has detected nothing.
    share = np.divide(1.0, truths, out=np.zeros_like(truths), where=truths > 0.0)
    gains = np.diff(matched, axis=1, prepend=0.0)
    precision = matched / np.maximum(matched + false, 1.0)
    found = [np.where(false <= most * frames, matched, 0.0).max(axis=1, initial=0.0) for most in false_alarms]
    return np.stack([np.sum(gains * precision, axis=1), *found]) * share
