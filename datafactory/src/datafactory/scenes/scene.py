"""The scene as plain float64 arrays: every reader returns one, and every later step takes one.

This module depends on neither USD nor Mitsuba nor Sionna. Readers convert their input to metres, z up and one world
frame. Objects stand where they are at time 0, one mesh each.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.targets.models import RcsModel

Vector = tuple[float, float, float]
ZERO = (0.0, 0.0, 0.0)
WORLD_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """The vertices of one instance of a mesh that several objects share.

    :param points: [P, 3] of the shared mesh in its own coordinates, in any precision
    :param used: [V] the points that are vertices of the object
    :param matrix: [4, 4] from the mesh's coordinates to the world, acting on column vectors
    """

    points: NDArray[np.floating]
    used: NDArray[np.integer]
    matrix: NDArray[np.float64]

    def world(self) -> NDArray[np.float64]:
        """[V, 3] world coordinates [m]."""
        return placed(self.points, self.matrix)[self.used]


def placed(points: NDArray[np.floating], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """[P, 3] points after an affine transform [4, 4], in float64; points that are not finite stay so."""
    with np.errstate(invalid="ignore", over="ignore"):
        world: NDArray[np.float64] = np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return world


class _WorldVertices:
    """The field ``vertices``: an array, or points of a shared mesh that are placed at each access."""

    def __get__(self, item: SceneObject | None, owner: type) -> NDArray[np.float64]:
        if item is None:
            raise AttributeError("vertices")  # the field has no default
        stored: NDArray[np.float64] | PlacedPoints = item.__dict__["vertices"]
        return stored.world() if isinstance(stored, PlacedPoints) else stored

    def __set__(self, item: SceneObject, value: NDArray[np.float64] | PlacedPoints) -> None:
        item.__dict__["vertices"] = value


@dataclass(frozen=True)
class SceneObject:
    """One triangle mesh of one material, at time 0.

    :param name: unique within the scene, e.g. the prim path
    :param vertices: [V, 3] world coordinates [m], float64; of an instance they are computed at each access
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

    @staticmethod
    def of(
        name: str,
        vertices: NDArray[np.float64] | PlacedPoints,
        triangles: NDArray[np.int32],
        material: str = "",
        velocity: Vector = ZERO,
    ) -> SceneObject:
        """An object with vertices of its own, or one that shares points and triangles with other instances."""
        return SceneObject(name, cast(NDArray[np.float64], vertices), triangles, material, velocity)


setattr(SceneObject, "vertices", _WorldVertices())  # noqa: B010  after the dataclass, to which it would be a default


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
        lower, upper = self._corners
        return lower.copy(), upper.copy()

    @cached_property
    def _corners(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        # Object by object: the vertices of instances are computed at each access.
        corners = [np.array([target.position, target.position]) for target in self.targets]
        for item in self.objects:
            vertices = item.vertices
            corners.append(np.stack([vertices.min(axis=0), vertices.max(axis=0)]))
        every = np.stack(corners)
        return every[:, 0].min(axis=0), every[:, 1].max(axis=0)

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
