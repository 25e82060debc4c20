"""Streets: of a scene's free ground, what a car can drive to, where one would drive, and which split has which part.

What counts as a street, whether a file names its roads or not: docs/trajectories.md#where-drawn-poses-stand.

The streets are cut into three regions, one a split, across their longer side, with strips between them that no pose
stands in. What a pose *sees* may reach over a gap, so a gap alone does not keep the splits apart: each split also has
its own side of the middle of every gap, and drawn poses look at nothing on another's (:mod:`datafactory.scenes.poses`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from shared.physics.compiled import compiled

Mask = NDArray[np.bool_]

ROUTE_CLEARANCE_M = 1.0
"""Half of a car's width: what a way needs on both sides."""
WIDEST_STREET_M = 40.0
"""From facade to facade, in at least one direction."""
AXES = 8
"""Directions in which facades are looked for, each both ways: every 22.5 deg."""
KERB_M = 3.0
"""Free ground this near to a road that is named is its kerb."""
LEAST_STREETS_M2 = 500.0
"""With less than this between its facades a scene has no streets, and all its free ground is used."""
LEAST_SHARE = 0.1
"""Where roads are named: of those on the ground that holds most of them. Rails and ledges part them from each other."""


SHARES = (6.0, 1.0, 1.0)
"""Areas of the regions, in the proportion of their frames."""
LEAST_GAP_M = 5.0
GAP_SHARE = 0.06
"""Of the extent: the gaps of a larger scene are wider."""


def reachable(free: Mask, passable: Mask, named: Mask) -> Mask:
    """The free cells with a way over passable cells to the largest free ground, or to a worthwhile share of the roads.

    :param free: [nx, ny]
    :param passable: [nx, ny] cells that a car's middle may pass; all free cells are among them
    :param named: [nx, ny] cells of objects named as roads; where none of them is free the largest free ground counts
    """
    label, count = ndimage.label(passable, structure=np.ones((3, 3), dtype=bool))
    if count == 0:
        return free
    sizes, roads = (np.bincount(label[cells], minlength=count + 1) for cells in (free, free & named))
    kept = roads >= LEAST_SHARE * roads.max() if roads.any() else np.arange(count + 1) == np.argmax(sizes)
    return free & kept[label]


def streets(free: Mask, road: Mask, obstacle: Mask, cell_m: float) -> Mask:
    """[nx, ny] free cells on roads and their kerbs, without any named road all, and of these those between facades.

    The last only where there are enough of them: a road over open land is a street too.

    :param road: free cells of objects named as roads
    """
    driven = free & (ndimage.distance_transform_edt(~road) * cell_m <= KERB_M) if road.any() else free
    between = _between_facades(driven, obstacle, int(WIDEST_STREET_M / cell_m), AXES)
    return between if np.count_nonzero(between) * cell_m**2 >= LEAST_STREETS_M2 else driven


@compiled()
def _between_facades(free, obstacle, reach, axes):
    """Free cells from which, along some axis, obstacles stand both ways, at most ``reach`` cells apart."""
    rows, columns = free.shape
    between = np.zeros_like(free)
    for i in range(rows):
        for j in range(columns):
            if not free[i, j]:
                continue
            for axis in range(axes):
                dx = np.cos(np.pi * axis / axes)
                dy = np.sin(np.pi * axis / axes)
                total = 0
                for sign in (1.0, -1.0):
                    step = 1
                    while step <= reach - total:
                        x = int(np.rint(i + sign * step * dx))
                        y = int(np.rint(j + sign * step * dy))
                        if x < 0 or x >= rows or y < 0 or y >= columns:
                            step = reach + 1
                        elif obstacle[x, y]:
                            break
                        else:
                            step += 1
                    total += step
                    if total > reach:
                        break
                if total <= reach:
                    between[i, j] = True
                    break
    return between


def cut_into_regions(cells: Mask, cell_m: float) -> tuple[NDArray[np.int8], NDArray[np.int8], float]:
    """Cut cells along their longer axis into train, gap, validation, gap, test, areas about 6 : 1 : 1.

    The gap is at least 5 m and at least 6 % of the extent. Where the ground is too short for gaps and three regions,
    train has it all and the others stay empty.

    :return: [nx, ny] index into ``SPLITS`` of the region that a cell belongs to, -1 for those in gaps and all others;
        [nx, ny] that of the split on whose side of the gaps' middles any cell lies, used or not; width of the gaps [m]
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
    return region, side, gap * cell_m
