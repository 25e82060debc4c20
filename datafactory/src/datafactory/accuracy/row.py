"""A row of the price list, and the figures in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.errors import detections_changed, level_db

SAME_PATHS = "same paths: cube at 1e-11 in complex128, truth by the virtual sensor's whole cube"
DEFAULTS = "defaults"


@dataclass(frozen=True)
class Row:
    """One setting of one knob, measured; errors are the largest over the frames.

    :param seconds: a frame on one core; :param stage_seconds: the same by stage
    :param seconds_beside: of an effect or another way the seconds of a frame without that change, timed in turn;
        times that lie minutes apart differ by more than most changes do. None for other rows
    :param cube_error_db: relative L2; for power knobs of the amplitudes in cells, rms over realisations
    :param image_error_db: largest difference over the peak; for power knobs of the amplitudes in cells, mean over
        realisations
    :param image_l2_db: relative L2 of the images; for power knobs as ``cube_error_db``
    :param power_error_db: of the amplitudes in cells, over their peak, mean over realisations; None for signal knobs
    :param power_l1_db, power_l1_range_weighted_db: for power knobs sum |P - P_ref| / sum P_ref over cells [dB], mean
        over realisations; the second with both weighted by range^4
    :param power_bias_db: total power over the reference's [dB]
    :param detections_changed: [%] of the truth's cells above noise; for power knobs the speckle's change is in it
    :param doppler_rows_changed: [%] of the image rows with a detection whose strongest Doppler cell is another
    :param peak_mb: growth of the resident set [MB], see :mod:`datafactory.accuracy.clock`
    :param work: counted multiply-adds; :param paths: mean over the frames, after pruning
    :param reference: what the errors are held against
    :param plan_db: of an effect what leaving it out of the first frame changes, as `datafactory plan` says it; None for
        other rows
    """

    knob: str
    setting: str
    default: bool
    kind: str
    seconds: float
    stage_seconds: dict[str, float]
    seconds_beside: float | None
    cube_error_db: float
    image_error_db: float
    image_l2_db: float
    power_error_db: float | None
    power_l1_db: float | None
    power_l1_range_weighted_db: float | None
    power_bias_db: float
    detections_changed: float
    doppler_rows_changed: float
    peak_mb: float
    paths: float
    work: float
    reference: str
    plan_db: float | None = None

    def planned(self, changes_db: Mapping[str, float]) -> Row:
        """This row with what its effect changes.

        By the measure of :mod:`datafactory.effects.losses`. The row's errors are others: of effects on the signal
        relative L2 of whole cubes; of effects on the paths the difference of two traces.

        :param changes_db: by effect
        """
        return replace(self, plan_db=changes_db.get(self.knob))


def worst(ratios: Sequence[float]) -> float:
    return level_db(max(ratios))


def widest(ratios: Sequence[float]) -> float:
    """The power ratio furthest from 1, in dB."""
    return max((0.5 * level_db(ratio) for ratio in ratios), key=abs)


def changed(values: Sequence[NDArray[np.bool_]], expected: Sequence[NDArray[np.bool_]]) -> float:
    return max(detections_changed(a, b) for a, b in zip(values, expected, strict=True))


def moved(
    cells: Sequence[NDArray[np.int64]], expected: Sequence[NDArray[np.int64]], detections: Sequence[NDArray[np.bool_]]
) -> float:
    """Rows with a detection whose Doppler cell is another, in percent of all rows with one."""
    differ = [(a != b)[map_.any(axis=1)] for a, b, map_ in zip(cells, expected, detections, strict=True)]
    every = np.concatenate(differ)
    return 100.0 * float(every.mean()) if len(every) else 0.0
