"""Pruning: the weakest scattered paths of each range bin are left out.

The paths left out hold together at most a given share of their bin's power (incoherent sum, patterns applied). Each bin
is treated alone: a weak echo far away is never compared with a strong one nearby.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.rising import rising
from datafactory.paths.table import PathTable
from shared.physics.compiled import compiled
from shared.physics.units import db_to_power
from shared.radar import Radar

DEFAULT_LEVEL_DB = -40.0
"""Ten dB below the default error budget of -30 dB."""
UNPRUNED_DB = -200.0
"""Keeps every path that float64 can tell from zero."""


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
    if not len(group):
        return np.zeros(0, dtype=bool)
    group = group - group.min()
    return _weakest(_by_group_and_power(group, power), group, power, np.bincount(group, power), share)


@compiled()
def _weakest(order, group, power, total, share):
    """[K] as :func:`_negligible`.

    :param order: of the members, group by group, within a group the weakest first; :param total: power of each group
    """
    result = np.empty(len(order), dtype=np.bool_)
    before, held = -1, 0.0
    for k in order:
        held = power[k] + (held if group[k] == before else 0.0)
        before = group[k]
        result[k] = held <= share * total[before]
    return result


def _by_group_and_power(group: NDArray[np.int64], power: NDArray[np.float64]) -> NDArray[np.int64]:
    """``np.lexsort((power, group))``: floats from 0 on rise with their bits."""
    order = rising(power.view(np.int64))
    return order[rising(group[order])]
