"""The scene as plain float64 arrays: every reader returns one, and every later step takes one.

This module depends on neither USD nor Mitsuba nor Sionna. Readers convert their input to metres, z up and one world
frame. Objects stand where they are at time 0, one mesh each.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.targets.models import RcsModel

Vector = tuple[float, float, float]
ZERO = (0.0, 0.0, 0.0)
WORLD_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class SceneObject:
    """One triangle mesh of one material, at time 0.

    :param name: unique within the scene, e.g. the prim path
    :param vertices: [V, 3] world coordinates [m], float64
    :param triangles: [T, 3] vertex indices, int32; every triangle has a positive area
    :param material: the name that the source gave its material, e.g. ``"mat-itu_concrete"``; "" where it gave none
    :param velocity: world velocity [m/s] of the whole object (rigid translation)
    """

    name: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    material: str = ""
    velocity: tuple[float, float, float] = ZERO

    @property
    def moves(self) -> bool:
        return any(component != 0.0 for component in self.velocity)


@dataclass(frozen=True)
class PointTarget:
    """A target with a radar cross section in place of a mesh.

    :param name: unique within the scene
    :param position: world position [m] at time 0
    :param rcs_dbsm: radar cross section [dB relative to 1 m^2]; of a model its nominal one, for lists
    :param velocity: world velocity [m/s]
    :param model: where and how strongly the target echoes, by aspect; None for ``rcs_dbsm`` from everywhere
    :param axes: x, y and z of the model's frame in the world, right-handed unit vectors
    """

    name: str
    position: Vector
    rcs_dbsm: float
    velocity: Vector = ZERO
    model: RcsModel | None = None
    axes: tuple[Vector, Vector, Vector] = WORLD_AXES


@dataclass(frozen=True)
class Scene:
    """The contents of a scene file, in metres and z up.

    :param name: short name, used in the dataset's ``scene`` column
    :param objects: the meshes, in the source's order
    :param targets: point targets with a radar cross section
    :param source: the path or ``sionna:NAME`` it was read from
    :param warnings: what the reader ignored, with counts, e.g. ``"3 prims of type Curves ignored"``
    """

    name: str
    objects: tuple[SceneObject, ...]
    targets: tuple[PointTarget, ...] = ()
    source: str = ""
    warnings: tuple[str, ...] = field(default=())

    @property
    def triangle_count(self) -> int:
        return sum(len(item.triangles) for item in self.objects)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner [m] of everything in the scene, each [3]."""
        points = [item.vertices for item in self.objects] + [np.array([target.position]) for target in self.targets]
        every = np.concatenate(points)
        return every.min(axis=0), every.max(axis=0)

    def content_hash(self) -> str:
        """SHA-256 over geometry, materials, velocities and targets, independent of the file they came from."""
        digest = hashlib.sha256()
        for item in self.objects:
            digest.update(repr((item.name, item.material, item.velocity, item.vertices.shape)).encode())
            digest.update(np.ascontiguousarray(item.vertices, dtype="<f8").tobytes())
            digest.update(np.ascontiguousarray(item.triangles, dtype="<i4").tobytes())
        for target in self.targets:
            digest.update(repr(target).encode())
        return digest.hexdigest()
