"""The things of a scene: what each mesh or point target is a part of, and what was put into the scene besides.

A thing is one car, one pedestrian, one gate: whatever meshes and point targets it is made of. A reader labels each of
them with its thing. The class is the one that the source states, of a target with the model of a road user that of the
road user, of everything else ``"other"``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain, Real

FOLDER = "populate"
"""The names of what is put into a scene begin with it."""
OTHER = "other"
"""Class of what moves and states none."""
OF_MODELS = {"car": "car", "pedestrian": "pedestrian", "cyclist": "bicycle"}
"""Classes that the models of road users imply; a bicycle has its rider."""


@dataclass(frozen=True)
class Strip:
    """A rectangle seen from above: a piece of straight road, or what a body takes up.

    :param middle: (x, y) [m]; :param heading_rad: of its length
    """

    middle: tuple[float, float]
    heading_rad: float
    length_m: float
    half_width_m: float

    def coordinates(self, x: Real, y: Real) -> tuple[Real, Real]:
        """How far points lie along it from its middle, and to its left [m]."""
        cosine, sine = np.cos(self.heading_rad), np.sin(self.heading_rad)
        east, north = x - self.middle[0], y - self.middle[1]
        return cosine * east + sine * north, cosine * north - sine * east

    def places(self, along: Real, left: Real) -> tuple[Real, Real]:
        """World x and y [m] of points by their coordinates."""
        cosine, sine = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return self.middle[0] + cosine * along - sine * left, self.middle[1] + sine * along + cosine * left

    def holds(self, x: Real, y: Real) -> NDArray[np.bool_]:
        """Whether points lie on it."""
        along, left = self.coordinates(x, y)
        inside: NDArray[np.bool_] = (np.abs(along) <= 0.5 * self.length_m) & (np.abs(left) <= self.half_width_m)
        return inside

    def corners(self) -> Real:
        """[4, 2] counter-clockwise [m]."""
        cosine, sine = np.cos(self.heading_rad), np.sin(self.heading_rad)
        ahead, left = 0.5 * self.length_m * np.array([cosine, sine]), self.half_width_m * np.array([-sine, cosine])
        return np.array(self.middle) + np.array([-ahead - left, ahead - left, ahead + left, left - ahead])

    def overlaps(self, other: Strip, apart_m: float = 0.0) -> bool:
        """Whether the two meet, or come nearer than ``apart_m``: no side of either separates them."""
        for one, far in ((self, other), (other, self)):
            sides = zip(one.coordinates(*far.corners().T), (0.5 * one.length_m, one.half_width_m), strict=True)
            if any(at.min() >= half + apart_m or at.max() <= -half - apart_m for at, half in sides):
                return False
        return True


@dataclass(frozen=True)
class Population:
    """What was put into a scene.

    :param text: what was asked for, as ``--populate`` takes it
    :param seed: of the dataset
    :param asked: numbers by kind, without what was asked for as a density; :param placed: numbers by kind
    :param roads: where it drives
    :param horizon_s: traffic runs from time 0 to here
    """

    text: str
    seed: int
    asked: dict[str, int]
    placed: dict[str, int]
    roads: tuple[Strip, ...]
    horizon_s: float

    def line(self) -> str:
        """What to tell the user."""
        metres = sum(road.length_m for road in self.roads)
        got = ", ".join(f"{count} {kind}" for kind, count in self.placed.items() if count) or "nothing"
        return f"populated with {got}, along {metres:.0f} m of road"

    def left_out(self) -> tuple[str, ...]:
        """What did not fit, one line each kind."""
        return tuple(
            f"{self.placed[kind]} of {count} {kind} placed: there is no more room on its free ground"
            for kind, count in self.asked.items()
            if self.placed[kind] < count
        )

    def to_json(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "populate": self.text, "seed": self.seed, "asked": self.asked, "placed": self.placed,
            "roads": len(self.roads), "road_m": round(sum(road.length_m for road in self.roads), 1),
            "horizon_s": self.horizon_s,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Label:
    """What a mesh or a point target is a part of.

    :param thing: name of the thing, unique in the scene: all of its parts have it
    :param frame: from the thing's own coordinates to the world, at all times
    :param class_name: as the source states it; "" where it states none
    """

    thing: str
    frame: Chain
    class_name: str = ""

    def fingerprint(self) -> bytes:
        """Equal for equal labels: what its boxes depend on that the meshes do not say."""
        home = np.ascontiguousarray(self.frame.at(0.0)[0], dtype="<f8")
        return repr((self.thing, self.class_name)).encode() + home.tobytes()
