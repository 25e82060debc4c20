"""The sides of a block as frames of their own, so that one builder serves all four.

A frame's x runs along the side, to the right for somebody who stands in the street and looks at the block; its y runs
into the block. That is the frame of :mod:`datafactory.scenes.city.buildings`, whose front faces -y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from datafactory.scenes.city.plan import Rectangle

YAW_DEG = {"south": 0.0, "east": 90.0, "north": 180.0, "west": 270.0}


@dataclass(frozen=True)
class Frontage:
    """One side of a block.

    :param x, y: of its origin, the left end seen from the street [m]
    :param length: [m]
    :param yaw_deg: of its x axis
    """

    x: float
    y: float
    length: float
    yaw_deg: float

    def place(self, along: float, inwards: float, z: float = 0.0) -> tuple[float, float, float]:
        """World place of a point ``along`` the side and ``inwards`` of it [m]."""
        cosine, sine = round(math.cos(math.radians(self.yaw_deg))), round(math.sin(math.radians(self.yaw_deg)))
        return self.x + cosine * along - sine * inwards, self.y + sine * along + cosine * inwards, z


def frontage(area: Rectangle, side: str) -> Frontage:
    """The side of a rectangle: ``"south"``, ``"east"``, ``"north"`` or ``"west"``."""
    x, y, length = {
        "south": (area.x0, area.y0, area.width),
        "east": (area.x1, area.y0, area.depth),
        "north": (area.x1, area.y1, area.width),
        "west": (area.x0, area.y1, area.depth),
    }[side]
    return Frontage(x, y, length, YAW_DEG[side])
