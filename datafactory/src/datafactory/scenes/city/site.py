"""Things that stand in a scene, or move through it, and the site on which builders place them.

What would stand inside something else is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.footprints import Footprint, Occupied, body_boxes, footprints_of
from datafactory.scenes.city.shapes import Surface

Vector = tuple[float, float, float]


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
        self.occupied = Occupied()
        self._counts: dict[str, int] = {}
        self._boxes_of_models: dict[str, NDArray[np.float64]] = {}

    def place(
        self,
        group: str,
        kind: str,
        what: str | Surface,
        position: Vector,
        yaw_deg: float = 0.0,
        margin: float = 0.0,
    ) -> bool:
        """Place something that rests, unless it would stand inside something else; whether it was placed.

        :param what: the name of a model, or a surface of its own
        :param margin: free space around it [m]
        """
        bodies = self.footprints(what, position, yaw_deg)
        if not all(self.occupied.free(body.grown(margin)) for body in bodies):
            return False
        for body in bodies:
            self.occupied.add(body)
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
        self,
        group: str,
        kind: str,
        what: str | Surface,
        position: Vector,
        yaw_deg: float = 0.0,
        keyframes: Sequence[Keyframe] = (),
    ) -> None:
        """Add something whose place is known to be free, such as what moves in a lane."""
        model = what if isinstance(what, str) else ""
        surface = self.models[what] if isinstance(what, str) else what
        number = self._counts.get(kind, 0)
        self._counts[kind] = number + 1
        x, y, z = (round(value, 3) + 0.0 for value in position)
        self.placements.append(
            Placement(
                f"{group}/{kind}_{number}",
                surface,
                (x, y, z),
                round(yaw_deg, 2),
                model=model,
                keyframes=tuple(keyframes),
                radar_class=CLASSES.get(kind, ""),
            )
        )
