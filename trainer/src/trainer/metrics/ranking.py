"""Detections of many frames in the order of their scores: average precision, detection probability at false alarms.

Frames are pooled: one threshold holds for all of them. Detections of equal score are above a threshold together or not
at all, so that their order changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trainer.metrics.bootstrap import UNDEFINED, Interval, bootstrap_frames
from trainer.metrics.cells import CellScores

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
