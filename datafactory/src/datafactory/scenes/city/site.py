"""Things that stand in a scene, or move through it, and the site on which builders place them.

What would stand inside something else, seen from above, is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.motion import Vector
from datafactory.scenes.things import Strip

TOUCH_M = 0.01
"""Things that overlap by less stand beside each other."""
CELL_M = 20.0


@dataclass(frozen=True)
class Keyframe:
    """Where a moving thing is at a time; straight on to the next one.

    :param time_s: since the scene's time 0 [s]
    :param position: world [m]
    :param yaw_deg: right-handed rotation about z [degree], not wrapped: 350 to 370 is a turn by 20
    """

    time_s: float
    position: Vector
    yaw_deg: float


@dataclass(frozen=True)
class Placement:
    """One thing in the scene.

    :param path: below /World, e.g. ``"Cars/Car_3"``, unique
    :param surface: its shape in its own frame; None for a bare point target
    :param position: of its frame's origin [m], world
    :param yaw_deg: right-handed rotation about z [degree]
    :param velocity: world velocity [m/s], for ever
    :param rcs_dbsm: radar cross section [dBsm] of the point target that stands for it; None where the mesh counts
    :param model: name under which placements share one surface; "" where the surface is its own
    :param keyframes: how it moves, rising in time; empty where it rests or goes straight on for ever
    :param radar_class: what a detector is to call it (``radar:class``), e.g. ``"car"``; "" for what is no object
    """

    path: str
    surface: Surface | None
    position: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    velocity: Vector = (0.0, 0.0, 0.0)
    rcs_dbsm: float | None = None
    model: str = ""
    keyframes: tuple[Keyframe, ...] = ()
    radar_class: str = ""


CLASSES = {
    "Car": "car", "Lorry": "truck", "Bus": "bus", "Cyclist": "bicycle", "Pedestrian": "pedestrian",
    "Lamp": "pole", "Bollard": "pole", "Signal": "pole", "Sign": "sign", "Gantry": "sign",
    "Tree": "tree", "Conifer": "tree", "Hedge": "tree",
}  # fmt: skip
"""``radar:class`` by kind; what is not listed has none, and is background."""


class Site:
    """Collects placements while builders draw from one generator, in a fixed order.

    :param rng: of all draws
    :param models: surfaces that placements share, by name
    """

    def __init__(self, rng: np.random.Generator, models: dict[str, Surface]) -> None:
        self.rng = rng
        self.models = models
        self.placements: list[Placement] = []
        self._counts: dict[str, int] = {}
        self._taken: dict[tuple[int, int], list[Footprint]] = {}  # by the cells that they touch
        self._boxes_of_models: dict[str, NDArray[np.float64]] = {}

    def place(
        self, group: str, kind: str, what: str | Surface, position: Vector, yaw_deg: float = 0.0, margin: float = 0.0
    ) -> bool:
        """Place something that rests, unless it would stand inside something else; whether it was placed.

        :param what: the name of a model, or a surface of its own
        :param margin: free space around it [m]
        """
        bodies = self.footprints(what, position, yaw_deg)
        for body in bodies:
            wanted = body.grown(margin)
            if any(wanted.overlaps(other) for cell in wanted.cells() for other in self._taken.get(cell, ())):
                return False
        for body in bodies:
            for cell in body.cells():
                self._taken.setdefault(cell, []).append(body)
        self.add(group, kind, what, position, yaw_deg)
        return True

    def footprints(self, what: str | Surface, position: Vector, yaw_deg: float) -> list[Footprint]:
        """What the bodies of something take up where it is placed."""
        if not isinstance(what, str):
            return footprints_of(body_boxes(what), position, yaw_deg)
        if what not in self._boxes_of_models:
            self._boxes_of_models[what] = body_boxes(self.models[what])
        return footprints_of(self._boxes_of_models[what], position, yaw_deg)

    def add(
        self, group: str, kind: str, what: str | Surface, position: Vector, yaw_deg: float = 0.0,
        keyframes: Sequence[Keyframe] = (),
    ) -> None:  # fmt: skip
        """Add something whose place is known to be free, such as what moves in a lane."""
        model = what if isinstance(what, str) else ""
        surface = self.models[what] if isinstance(what, str) else what
        number = self._counts.get(kind, 0)
        self._counts[kind] = number + 1
        x, y, z = (round(value, 3) + 0.0 for value in position)
        thing = Placement(f"{group}/{kind}_{number}", surface, (x, y, z), round(yaw_deg, 2), model=model)
        self.placements.append(replace(thing, keyframes=tuple(keyframes), radar_class=CLASSES.get(kind, "")))


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

    def cells(self) -> Iterator[tuple[int, int]]:
        """The cells of a coarse grid that it may touch: only what shares one with it can overlap it."""
        corners = self.ground.corners() / CELL_M
        (x0, y0), (x1, y1) = np.floor(corners.min(axis=0)), np.floor(corners.max(axis=0))
        return product(range(int(x0), int(x1) + 1), range(int(y0), int(y1) + 1))


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
