"""What is looked at: one scene from one pose, with the paths of that frame; rays into it; the colours of what is seen.

The colours of materials and of kinds of path are the same in the page and in the pictures.
"""

from __future__ import annotations

import colorsys
import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datafactory.frame.deal import PreparedScene
from datafactory.paths.backend import select_variant
from datafactory.paths.geometry import Geometry, first_hits, mesh_of_shape
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.table import PathTable
from datafactory.scenes.boxes import seen_things
from datafactory.scenes.motion import Real, Vector, triple
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import ZERO
from shared.physics.vectors import dots
from shared.radar import Radar

ARCS_M = (10.0, 20.0, 40.0, 80.0)
"""Ranges at which the field of view has an arc."""
ARC_POINTS = 49
Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""
MATERIALS: dict[str, Colour] = {
    "concrete": (178, 176, 170), "road_concrete": (150, 149, 145), "asphalt": (92, 93, 98), "brick": (178, 98, 74),
    "plasterboard": (222, 214, 198), "ceiling_board": (232, 228, 220), "marble": (214, 206, 214),
    "wood": (176, 132, 84), "chipboard": (196, 158, 110), "plywood": (206, 172, 124), "floorboard": (158, 112, 66),
    "glass": (126, 186, 214), "acrylic": (160, 204, 224), "metal": (70, 110, 168), "polypropylene": (98, 88, 150),
    "tyre_rubber": (52, 50, 54), "very_dry_ground": (206, 184, 140), "medium_dry_ground": (172, 148, 104),
    "wet_ground": (128, 106, 74), "water": (74, 132, 196), "vegetation": (106, 154, 84), "human_skin": (226, 168, 140),
}  # fmt: skip
"""Of the material table, as one would paint them; metal is blue, so that it stands out."""
DIRECT, MIRROR, SEVERAL = "direct scatter", "mirror", "multi-bounce"
DIFFRACTION, REFRACTION = "diffraction", "refraction"
KINDS: dict[str, Colour] = {
    DIRECT: (213, 94, 0), MIRROR: (0, 114, 178), SEVERAL: (160, 32, 120), DIFFRACTION: (0, 140, 90),
    REFRACTION: (204, 153, 0),
}  # fmt: skip
"""Kinds of path, after Okabe and Ito, Color Universal Design, 2008: told apart with any kind of colour vision."""
SENSOR: Colour = (20, 20, 20)
MOTION: Colour = (220, 20, 60)
TARGET: Colour = (255, 0, 160)


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene from a pose, all places in that pose's radar frame: x forward, y left, z up, the sensor at the origin.

    :param title: what the page and the pictures are called
    :param table: the frame's paths, illuminated by the radar; None where none were traced
    """

    title: str
    scene: PreparedScene
    pose: Pose
    radar: Radar
    table: PathTable | None = None

    @cached_property
    def caster(self) -> RayCaster:
        """Rays into the scene from this pose."""
        return RayCaster(self.scene.merged, self.pose)

    @cached_property
    def merged(self) -> MergedScene:
        """The scene at the pose's time."""
        return self.scene.merged.at(self.pose.time_s)

    def vertices(self, mesh: int) -> Real:
        """[V, 3] of a merged mesh [m]."""
        item = self.merged.meshes[mesh]
        return self.pose.seen(item.vertices + item.shift)

    def targets(self) -> Real:
        """[T, 3] where the point targets stand [m]."""
        return self.pose.seen(
            np.array([item.position for item in self.merged.targets], dtype=np.float64).reshape(-1, 3)
        )

    def movers(self) -> list[tuple[str, Vector, Vector]]:
        """The things of the scene that move at the pose's time, then the sensor itself if it does.

        Of each its name, where its middle is [m], and its velocity over ground in the radar frame's axes [m/s].
        """
        seen = seen_things(self.scene.things, replace(self.pose, velocity=ZERO))
        found = [(thing.name, thing.center, thing.velocity) for thing in seen if any(thing.velocity)]
        if any(self.pose.velocity):
            found.append(("sensor", ZERO, triple(np.array(self.pose.velocity) @ self.pose.rotation())))
        return found

    def field_of_view(self) -> list[Real]:
        """Lines [n, 3] round what the image covers, level with the sensor [m]: edges in u, arcs of equal range."""
        grid, farthest = self.radar.grid, float(self.radar.waveform.ranges_m[-1])
        azimuth = np.arcsin(np.clip(np.linspace(grid.u_start, grid.u_stop, ARC_POINTS), -1.0, 1.0))
        arc = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        radii = [radius for radius in ARCS_M if radius < farthest] or [farthest]
        edges = [np.stack([np.zeros(3), radii[-1] * arc[end]]) for end in (0, -1)]
        return edges + [radius * arc for radius in radii]


@dataclass(frozen=True, eq=False)
class Met:
    """What n rays met.

    :param distance: [n] [m]; infinite where nothing was met
    :param mesh: [n] index into ``MergedScene.meshes``; -1 where nothing was met
    :param normal: [n, 3] of the surface, unit, towards the ray's start
    """

    distance: Real
    mesh: NDArray[np.int64]
    normal: Real


class RayCaster:
    """A merged scene from one pose, at that pose's time.

    Mitsuba traces in float32: see :func:`datafactory.paths.geometry.ray_margin_m`.

    :param merged: the scene; without meshes every ray goes on for ever
    """

    def __init__(self, merged: MergedScene, pose: Pose) -> None:
        self._scene, merged = None, merged.at(pose.time_s)
        if merged.meshes:
            select_variant()
            self._scene = Geometry(merged).place(merged, pose).mi_scene
            self._mesh_of_shape = mesh_of_shape(self._scene)

    def cast(self, start: Real, direction: Real) -> Met:
        """What rays from ``start`` [n, 3] [m] along the unit vectors ``direction`` [n, 3] meet first."""
        count = len(start)
        nothing = Met(np.full(count, np.inf), np.full(count, -1, dtype=np.int64), np.zeros((count, 3)))
        if self._scene is None or not count:
            return nothing
        met = first_hits(self._scene, start, direction, np.full(count, np.inf))
        for number, index in self._mesh_of_shape.items():
            nothing.mesh[met.valid & (met.shape == number)] = index
        towards = -np.sign(dots(met.normal, direction))
        nothing.normal[met.valid] = (met.normal * towards[:, None])[met.valid]
        nothing.distance[met.valid] = met.distance[met.valid]
        return nothing


def material_colour(name: str) -> Colour:
    """A material's colour; one that is not in the table has one that follows from its name."""
    if name in MATERIALS:
        return MATERIALS[name]
    digest = hashlib.sha256(name.encode()).digest()
    red, green, blue = colorsys.hls_to_rgb(digest[0] / 256.0, 0.6, 0.35)
    return round(255 * red), round(255 * green), round(255 * blue)


def css(colour: Colour) -> str:
    """``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
