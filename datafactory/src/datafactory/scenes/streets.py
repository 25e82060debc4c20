"""Streets: of a scene's free ground, what a car can drive to, and where one would drive.

A file may name its roads. Most meshes of cities do not: there a street is free ground between two facades. Whatever it
is called, ground that no way leads to is left out: courtyards, the floor of a hollow building under a hole in its roof.
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


def reachable(free: Mask, passable: Mask) -> Mask:
    """The free cells with a way over passable cells to the largest free ground.

    :param free: [nx, ny]
    :param passable: [nx, ny] cells that a car's middle may pass; all free cells are among them
    """
    label, count = ndimage.label(passable, structure=np.ones((3, 3), dtype=bool))
    if count == 0:
        return free
    sizes = np.bincount(label[free], minlength=count + 1)
    sizes[0] = 0
    return free & (label == int(np.argmax(sizes)))


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
