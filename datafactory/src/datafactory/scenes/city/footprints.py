"""What stands where, seen from above: nothing is placed into something else."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.things import Strip

TOUCH_M = 0.01
"""Things that overlap by less stand beside each other."""


@dataclass(frozen=True)
class Footprint:
    """An upright box.

    :param ground: seen from above
    :param low, high: its heights [m]
    """

    ground: Strip
    low: float
    high: float

    def grown(self, margin: float) -> Footprint:
        """Larger to every side [m]."""
        length, half_width = self.ground.length_m + 2.0 * margin, self.ground.half_width_m + margin
        return replace(self, ground=replace(self.ground, length_m=length, half_width_m=half_width))

    def overlaps(self, other: Footprint) -> bool:
        """Whether the two have more in common than a touch."""
        apart = self.low >= other.high - TOUCH_M or other.low >= self.high - TOUCH_M
        return not apart and self.ground.overlaps(other.ground, -TOUCH_M)


def body_boxes(surface: Surface) -> NDArray[np.float64]:
    """[B, 2, 3] lower and upper corners of each body of a surface, in its own axes; what shares vertices is one."""
    size = len(surface.vertices)
    links = [(face[0], vertex) for face in surface.faces for vertex in face[1:]]
    one, other = np.array(links).T
    graph = coo_array((np.ones(len(links), dtype=np.int8), (one, other)), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lower, label, surface.vertices)
    np.maximum.at(upper, label, surface.vertices)
    return np.stack([lower, upper], axis=1)


def footprints_of(boxes: NDArray[np.float64], position: tuple[float, float, float], yaw_deg: float) -> list[Footprint]:
    """The boxes [B, 2, 3] of a surface's bodies where it is placed."""
    yaw = math.radians(yaw_deg)
    found = []
    for lower, upper in boxes:
        (mx, my, _), (length, width, _) = 0.5 * (lower + upper), upper - lower
        middle = (
            position[0] + math.cos(yaw) * mx - math.sin(yaw) * my,
            position[1] + math.sin(yaw) * mx + math.cos(yaw) * my,
        )
        ground = Strip(middle, yaw, length, 0.5 * width)
        found.append(Footprint(ground, position[2] + lower[2], position[2] + upper[2]))
    return found


class Occupied:
    """The footprints so far."""

    CELL_M = 20.0

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[Footprint]] = {}

    def free(self, wanted: Footprint) -> bool:
        """Whether nothing so far overlaps it."""
        near = {id(item): item for cell in self._touched(wanted) for item in self._cells.get(cell, ())}
        return not any(wanted.overlaps(item) for item in near.values())

    def add(self, item: Footprint) -> None:
        for cell in self._touched(item):
            self._cells.setdefault(cell, []).append(item)

    def _touched(self, item: Footprint) -> list[tuple[int, int]]:
        corners = item.ground.corners()
        (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
        columns = range(math.floor(x0 / self.CELL_M), math.floor(x1 / self.CELL_M) + 1)
        rows = range(math.floor(y0 / self.CELL_M), math.floor(y1 / self.CELL_M) + 1)
        return [(i, j) for i in columns for j in rows]
