"""Detections of many frames in the order of their scores: average precision, detection probability at false alarms.

Frames are pooled: one threshold holds for all of them. Detections of equal score are above a threshold together or not
at all, so that their order changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.metrics.bootstrap import Interval, bootstrap_frames
from trainer.metrics.cells import CellScores


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
        return float(self._scores(self._once(), ())[0, 0]) if self.defined else float("nan")

    def detection_probability(self, false_alarms: float) -> float:
        """Share of the truth cells that is detected at the lowest threshold of at most ``false_alarms`` a frame; NaN
        without truth cells."""
        return float(self._scores(self._once(), (false_alarms,))[1, 0]) if self.defined else float("nan")

    def curve(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([g] false alarms a frame, [g] detection probability) at each score, falling; empty without truth cells."""
        if not self.defined:
            return np.empty(0), np.empty(0)
        matched, false = self._counts(self._once())
        return false[0] / len(self.truths), matched[0] / self.truths.sum()

    def intervals(self, false_alarms: Sequence[float], seed: int = 0) -> list[Interval]:
        """Average precision, then the detection probability at each number of false alarms a frame, with their
        intervals over the frames; NaN without truth cells."""
        if not self.defined:
            return [Interval(float("nan"), float("nan"), float("nan"))] * (1 + len(false_alarms))
        return bootstrap_frames(lambda weights: self._scores(weights, false_alarms), len(self.truths), seed)

    def _once(self) -> NDArray[np.int32]:
        return np.ones((1, len(self.truths)), dtype=np.int32)

    def _counts(self, weights: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """([B, g] matched detections, [B, g] false alarms) down to each score, frame k counted weights[:, k] times."""
        weight = weights.astype(np.int32)[:, self.frame]  # (B, n)
        matched = np.cumsum(weight * self.matched, axis=1, dtype=np.int32)[:, self.last]
        return matched, np.cumsum(weight, axis=1, dtype=np.int32)[:, self.last] - matched

    def _scores(self, weights: NDArray[np.integer], false_alarms: Sequence[float]) -> NDArray[np.float64]:
        """[1 + len(false_alarms), B] see :meth:`intervals`, frame k counted weights[:, k] times."""
        matched, false = self._counts(weights)
        truths = weights @ self.truths
        # A draw without truth cells has detected nothing.
        share = np.divide(1.0, truths, out=np.zeros_like(truths), where=truths > 0)
        precision = matched / np.maximum(matched + false, 1)
        scores = [np.sum(np.diff(matched, axis=1, prepend=0) * precision, axis=1)]
        frames = weights.sum(axis=1)[:, None]
        scores += [np.where(false <= most * frames, matched, 0).max(axis=1, initial=0) for most in false_alarms]
        return np.stack(scores) * share


def pooled(frames: Sequence[CellScores]) -> Ranking:
    """The frames in one ranking.

    :raises InputError: no frames
    """
    if not frames:
        raise InputError("ranking", "no frames", "the scores of one or more")
    score = np.concatenate([part for one in frames for part in (one.matched, one.false_alarms)])
    sizes = np.array([(len(one.matched), len(one.false_alarms)) for one in frames])
    frame = np.repeat(np.arange(len(frames)), sizes.sum(axis=1))
    matched = np.repeat(np.tile([True, False], len(frames)), sizes.ravel())
    order = np.argsort(-score, kind="stable")
    falling = score[order]
    last = np.flatnonzero(np.append(falling[1:] != falling[:-1], True)) if len(falling) else np.empty(0, dtype=np.intp)
    truths = np.array([one.truths for one in frames], dtype=np.float64)
    return Ranking(truths, frame[order], matched[order], last)
