"""What is looked at: one scene from one pose, with the paths of that frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datafactory.frame.prepared import PreparedScene
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.table import PathTable
from datafactory.scenes.boxes import seen_things
from datafactory.scenes.motion import Vector, triple
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import ZERO
from datafactory.view.casting import RayCaster
from shared.radar import Radar

Real = NDArray[np.float64]

ARCS_M = (10.0, 20.0, 40.0, 80.0)
"""Ranges at which the field of view has an arc."""
ARC_POINTS = 49


@dataclass(frozen=True, eq=False)
class Mover:
    """Something that moves: where its middle is, radar frame [m], and its velocity over ground in that frame's axes."""

    name: str
    position: Vector
    velocity: Vector


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
        return self._seen(item.vertices + item.shift)

    def targets(self) -> Real:
        """[T, 3] where the point targets stand [m]."""
        return self._seen(np.array([item.position for item in self.merged.targets], dtype=np.float64).reshape(-1, 3))

    def movers(self) -> tuple[Mover, ...]:
        """The things of the scene that move at the pose's time, then the sensor itself if it does."""
        seen = seen_things(self.scene.things, replace(self.pose, velocity=ZERO))
        found = [Mover(thing.name, thing.center, thing.velocity) for thing in seen if any(thing.velocity)]
        if any(self.pose.velocity):
            found.append(Mover("sensor", ZERO, triple(np.array(self.pose.velocity) @ self.pose.rotation())))
        return tuple(found)

    def field_of_view(self) -> list[Real]:
        """Lines [n, 3] round what the image covers, level with the sensor [m]: edges in u, arcs of equal range."""
        grid, farthest = self.radar.grid, float(self.radar.waveform.ranges_m[-1])
        azimuth = np.arcsin(np.clip(np.linspace(grid.u_start, grid.u_stop, ARC_POINTS), -1.0, 1.0))
        arc = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        radii = [radius for radius in ARCS_M if radius < farthest] or [farthest]
        edges = [np.stack([np.zeros(3), radii[-1] * arc[end]]) for end in (0, -1)]
        return edges + [radius * arc for radius in radii]

    def _seen(self, world: Real) -> Real:
        return (world - np.asarray(self.pose.position)) @ self.pose.rotation()
