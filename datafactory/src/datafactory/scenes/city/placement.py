"""One thing that stands in a scene, or moves through it: the value that builders make and the writer writes."""

from __future__ import annotations

from dataclasses import dataclass

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
