"""What is looked at: one scene from one pose, with the paths of that frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datafactory.frame.prepared import PreparedScene
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.view.casting import RayCaster
from shared.radar import Radar

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mover:
    """Something that moves.

    :param position: [3] of its middle, radar frame [m]; :param velocity: [3] over ground, in the radar frame's axes
    """

    name: str
    position: Real
    velocity: Real

    @property
    def speed_mps(self) -> float:
        """[m/s]"""
        return float(np.linalg.norm(self.velocity))


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
        """What moves: the parts of one body as one, then point targets, then the sensor itself.

        Parts are objects of one velocity below one prim, or of one name where there are no prims.
        """
        merged, rotation = self.merged, self.pose.rotation()
        bodies: dict[tuple[str, tuple[float, ...]], list[Real]] = {}
        for number, mesh in enumerate(merged.meshes):
            if not mesh.velocity.any():
                continue
            corners = self.vertices(number)[mesh.triangles]  # [T, 3, 3]
            for index in np.unique(mesh.object_of_triangle):
                name = merged.objects[index]
                body = name.rpartition("/")[0] or name
                own = corners[mesh.object_of_triangle == index].reshape(-1, 3)
                bodies.setdefault((body, tuple(mesh.velocity)), []).append(np.stack([own.min(axis=0), own.max(axis=0)]))
        found = []
        for (name, velocity), boxes in bodies.items():
            middle = 0.5 * (np.min(boxes, axis=(0, 1)) + np.max(boxes, axis=(0, 1)))
            found.append(Mover(name, middle, np.array(velocity) @ rotation))
        for target, position in zip(merged.targets, self.targets(), strict=True):
            if any(target.velocity):
                found.append(Mover(target.name, position, np.array(target.velocity) @ rotation))
        if any(self.pose.velocity):
            found.append(Mover("sensor", np.zeros(3), np.array(self.pose.velocity) @ rotation))
        return tuple(found)

    def _seen(self, world: Real) -> Real:
        return (world - np.asarray(self.pose.position)) @ self.pose.rotation()
