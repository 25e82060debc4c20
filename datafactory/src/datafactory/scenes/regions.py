"""Regions: a scene's streets cut into three parts, one a split, with strips between them that no pose stands in.

The cuts lie across the longer side of the streets. What a pose *sees* may reach over a gap, so a gap alone does not
keep the splits apart: each split also has its own side of the middle of every gap, and drawn poses look at nothing on
another's (:mod:`datafactory.scenes.poses`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHARES = (6.0, 1.0, 1.0)
"""Areas of the regions, in the proportion of their frames."""
LEAST_GAP_M = 5.0
GAP_SHARE = 0.06
"""Of the extent: the gaps of a larger scene are wider."""


@dataclass(frozen=True, eq=False)
class Regions:
    """Cells cut into regions; arrays are [nx, ny].

    :param region: index into ``SPLITS`` of the region that a cell belongs to; -1 for cells in gaps and all others
    :param side: index into ``SPLITS`` of the split on whose side of the gaps' middles any cell lies, used or not
    :param gap_m: width of the gaps [m]
    """

    region: NDArray[np.int8]
    side: NDArray[np.int8]
    gap_m: float


def cut_into_regions(cells: NDArray[np.bool_], cell_m: float) -> Regions:
    """Cut cells along their longer axis into train, gap, validation, gap, test, areas about 6 : 1 : 1.

    The gap is at least 5 m and at least 6 % of the extent. Where the ground is too short for gaps and three regions,
    train has it all and the others stay empty.
    """
    extents = [np.flatnonzero(cells.any(axis=1 - axis)) for axis in (0, 1)]
    spans = [int(used[-1] - used[0] + 1) for used in extents]
    axis = int(np.argmax(spans))
    gap = int(np.ceil(max(LEAST_GAP_M, GAP_SHARE * spans[axis] * cell_m) / cell_m))
    lines = np.count_nonzero(cells, axis=1 - axis)
    total = np.concatenate([[0], np.cumsum(lines)])  # total[n]: free cells in lines 0 to n - 1
    # The end of the training region determines the other two cuts. The best end gives the best size of the test region.
    best = (np.inf, len(lines), len(lines))
    for end in range(1, len(lines) - 2 * gap):
        train = total[end]
        start = end + gap
        stop = int(np.searchsorted(total, total[start] + train * SHARES[1] / SHARES[0]))
        if stop + gap >= len(lines):
            break
        validation, test = total[stop] - total[start], total[-1] - total[stop + gap]
        if min(train, validation, test) > 0:
            best = min(best, (abs(float(test) - train * SHARES[2] / SHARES[0]), end, stop))
    _, end, stop = best
    position = np.arange(len(lines))
    along = np.full(len(lines), -1, dtype=np.int8)
    along[position < end] = 0
    along[(position >= end + gap) & (position < stop)] = 1
    along[position >= stop + gap] = 2
    nearest = (position + 0.5 > end + 0.5 * gap).astype(np.int8) + (position + 0.5 > stop + 0.5 * gap).astype(np.int8)
    shape = (-1, 1) if axis == 0 else (1, -1)
    region = np.where(cells, along.reshape(shape), -1).astype(np.int8)
    side = np.broadcast_to(nearest.reshape(shape), cells.shape).astype(np.int8)
    return Regions(region, side, gap * cell_m)
