"""A scene as the ray tracer sees it from one pose: meshes merged by material and velocity, in the radar frame.

The tracer works in float32. Vertices are brought to the radar's own origin and axes in float64 first, so that a scene
far from its origin loses nothing, and merged: identity of the objects is kept by the first triangle of each in its
mesh.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene


@dataclass(frozen=True, eq=False)
class MergedMesh:
    """Objects of one material and one velocity as one mesh.

    :param material: name in the material table
    :param velocity: world velocity [3] m/s
    :param vertices: [V, 3] world [m] at time 0, float64; :param triangles: [T, 3] int32
    :param object_of_triangle: [T] index into ``MergedScene.objects``
    """

    material: str
    velocity: NDArray[np.float64]
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    object_of_triangle: NDArray[np.int32]

    def seen_from(self, pose: Pose) -> NDArray[np.float32]:
        """[V, 3] vertices in the radar frame at the pose's time [m]."""
        world = self.vertices + self.velocity * pose.time_s - np.asarray(pose.position)
        return (world @ pose.rotation()).astype(np.float32)


@dataclass(frozen=True, eq=False)
class MergedScene:
    """All merged meshes of a scene.

    :param meshes: the merged meshes, in a fixed order
    :param objects: names of the scene's objects, then of its point targets
    :param targets: the point targets
    """

    meshes: tuple[MergedMesh, ...]
    objects: tuple[str, ...]
    targets: tuple[PointTarget, ...] = ()


def merge_scene(scene: Scene, materials: MaterialMapping) -> MergedScene:
    """Merge a scene's objects; the order depends on names and velocities alone."""
    groups: dict[tuple[str, tuple[float, float, float]], list[int]] = defaultdict(list)
    for index, item in enumerate(scene.objects):
        groups[materials[item.material].name, item.velocity].append(index)
    meshes = []
    for (material, velocity), members in sorted(groups.items()):
        parts = [scene.objects[index] for index in members]
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        meshes.append(
            MergedMesh(
                material=material,
                velocity=np.array(velocity),
                vertices=np.concatenate([part.vertices for part in parts]),
                triangles=np.concatenate([p.triangles + s for p, s in zip(parts, starts, strict=True)]).astype(
                    np.int32
                ),
                object_of_triangle=np.repeat(members, [len(part.triangles) for part in parts]).astype(np.int32),
            )
        )
    names = tuple(item.name for item in scene.objects) + tuple(target.name for target in scene.targets)
    return MergedScene(meshes=tuple(meshes), objects=names, targets=scene.targets)


def slabs_of(merged_scene: MergedScene, materials: MaterialMapping) -> tuple[Material, ...]:
    """Material of each merged mesh."""
    by_name = {material.name: material for material, _ in materials.entries.values()}
    return tuple(by_name[mesh.material] for mesh in merged_scene.meshes)
