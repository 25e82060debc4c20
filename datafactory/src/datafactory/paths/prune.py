"""Leaving out paths that no range bin would miss.

Within each range bin the weakest paths are dropped, as many as together hold at most a given share of the bin's power
(incoherent sum, patterns applied). Judged bin by bin, a weak echo far away is never weighed against a strong one
nearby.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.table import PathTable
from shared.radar import Radar
from shared.units import db_to_power

DEFAULT_LEVEL_DB = -40.0
"""Ten dB below the default error budget of -30 dB."""


def pruned(paths: PathTable, radar: Radar, level_db: float = DEFAULT_LEVEL_DB) -> PathTable:
    """The table without its scattered paths whose sum in their range bin stays below ``level_db``; the rest is counted.

    :param paths: illuminated paths
    """
    scattered = paths.scattered
    range_bin = np.floor(scattered.range_m() / radar.waveform.range_step_m).astype(np.int64)
    keep = ~_negligible(np.abs(scattered.amplitude) ** 2, range_bin, float(db_to_power(level_db)))
    counts = {**paths.counts, "pruned": int((~keep).sum())}
    return replace(paths, scattered=scattered.take(keep), counts=counts)


def _negligible(power: NDArray[np.float64], group: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    """[K] whether a member belongs to the weakest of its group that hold at most ``share`` of the group's power."""
    order = np.lexsort((power, group))
    running = np.cumsum(power[order])
    group = group[order]
    first = np.searchsorted(group, group, side="left")
    last = np.searchsorted(group, group, side="right") - 1
    before = running[first] - power[order][first]
    result = np.zeros(len(power), dtype=bool)
    result[order] = running - before <= share * (running[last] - before)
    return result
