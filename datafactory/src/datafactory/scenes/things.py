"""The things that were put into a scene: what each is, how large, where it is at a time, and what was asked for.

A thing is one car or one lamp, of however many meshes it is made. The names of its meshes begin with its own and a
slash; a thing that is a point target has the target's name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.motion import Track, Vector

Real = NDArray[np.float64]

CLASSES = ("car", "truck", "bus", "bicycle", "pedestrian", "pole", "sign", "other")
"""What a thing may be, as ``radar:class`` says it in a USD file; a bicycle has its rider."""


@dataclass(frozen=True)
class Thing:
    """One thing.

    :param name: unique in the scene
    :param label: one of ``CLASSES``
    :param size_m: length, width and height along its own axes
    :param position: of the middle of its underside at time 0, world [m]
    :param axes: its x (ahead), y (left) and z in the world, right-handed unit vectors
    :param motion: how it is shifted; None where it stands
    """

    name: str
    label: str
    size_m: Vector
    position: Vector
    axes: tuple[Vector, Vector, Vector]
    motion: Track | None = field(default=None, repr=False)

    @property
    def yaw_deg(self) -> float:
        """Of its x about z, from the world's x, positive to the left [degree]."""
        return float(np.degrees(np.arctan2(self.axes[0][1], self.axes[0][0])))

    def at(self, time_s: float) -> tuple[Real, Real]:
        """Where the middle of its underside is at a time [s], [3] m, and its velocity [3] m/s."""
        if self.motion is None:
            return np.array(self.position), np.zeros(3)
        shift, velocity = self.motion.at(time_s)
        return np.array(self.position) + shift, velocity


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
    :param things: all of it
    :param roads: where it drives
    :param horizon_s: traffic runs from time 0 to here
    """

    text: str
    seed: int
    asked: dict[str, int]
    placed: dict[str, int]
    things: tuple[Thing, ...] = field(repr=False)
    roads: tuple[Strip, ...]
    horizon_s: float

    @property
    def movers(self) -> tuple[Thing, ...]:
        return tuple(thing for thing in self.things if thing.motion is not None)

    def lines(self) -> tuple[str, ...]:
        """What to tell the user."""
        metres = sum(road.length_m for road in self.roads)
        got = ", ".join(f"{count} {kind}" for kind, count in self.placed.items() if count) or "nothing"
        return (f"populated with {got}, along {metres:.0f} m of road",)

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
