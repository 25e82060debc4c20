"""A scene as the ray tracer sees it from one pose: meshes merged by material and motion, in the radar frame.

The tracer works in float32. Vertices are brought to the radar's own origin and axes in float64 first, so that a scene
far from its origin loses nothing. Which object a triangle is of is kept.

A merged scene is that of one time: ``at`` gives another time's. Meshes that do not turn keep their vertices and are
shifted, so that whatever was found of their shape stays valid; of the others, vertices are computed anew, each with its
own velocity. A scene in which nothing moves is the same at all times.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.motion import Moving, Track, Vector, drift, triple
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import ZERO, PointTarget, Scene, SceneObject
from shared.physics.vectors import Index, Mask, Real, dots

Value = TypeVar("Value")


class Keeps(Protocol):
    """What has a place for what was found of it."""

    @property
    def found(self) -> dict[str, Any]: ...


Subject = TypeVar("Subject", bound=Keeps)


def found_once(find: Callable[[Subject], Value]) -> Callable[[Subject], Value]:
    """A function whose result is kept with its argument, and goes with it to other processes."""
    name = f"{find.__module__}.{find.__qualname__}"

    @wraps(find)
    def kept(subject: Subject) -> Value:
        if name not in subject.found:
            subject.found[name] = find(subject)
        value: Value = subject.found[name]
        return value

    return kept


@dataclass(frozen=True, eq=False)
class MergedMesh:
    """Objects of one material and one motion as one mesh, at one time.

    :param slab: what it is made of
    :param velocity: world velocity [3] m/s; of what turns, that of its vertices' mean
    :param vertices: [V, 3] world [m], float64, without ``shift``; :param triangles: [T, 3] int32
    :param object_of_triangle: [T] index into ``MergedScene.objects``
    :param track: how it is shifted; None: straight on with ``velocity``
    :param body: the meshes of one rigid body have equal ones
    :param shift: [3] what is to be added to the vertices [m]: the displacement from time 0
    :param turning: its objects, of what turns or changes its shape; none of all else
    :param vertex_velocities: [V, 3] of what turns, world [m/s]
    """

    slab: Material
    velocity: Real
    vertices: Real
    triangles: NDArray[np.int32]
    object_of_triangle: NDArray[np.int32]
    track: Track | None = None
    body: Hashable = None
    shift: Real = field(default_factory=lambda: np.zeros(3))
    turning: tuple[SceneObject, ...] = ()
    vertex_velocities: Real = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def material(self) -> str:
        """Name in the material table."""
        return self.slab.name

    @property
    def moves(self) -> bool:
        """Whether it is elsewhere at another time."""
        return bool(self.turning) or self.track is not None or bool(np.any(self.velocity))

    @property
    def rigid_body(self) -> Hashable:
        """Equal for meshes that keep their places to each other."""
        return tuple(self.velocity) if self.body is None else self.body

    def at(self, time_s: float) -> MergedMesh:
        """The mesh at a time, of a mesh at time 0."""
        if not self.moves:
            return self
        if not self.turning:
            shift, velocity = drift(triple(self.velocity), self.track, time_s)
            return replace(self, shift=shift, velocity=velocity)
        instants = [part.at(time_s) for part in self.turning]
        velocities = np.concatenate([item.velocities for item in instants])
        return replace(
            self,
            vertices=np.concatenate([item.vertices for item in instants]),
            velocity=velocities.mean(axis=0),
            vertex_velocities=velocities,
        )

    def seen_from(self, pose: Pose) -> NDArray[np.float32]:
        """[V, 3] vertices in the radar frame [m]."""
        return pose.seen(self.vertices + self.shift).astype(np.float32)


@dataclass(frozen=True, eq=False)
class MergedScene:
    """All merged meshes of a scene, at one time.

    :param meshes: the merged meshes, in a fixed order
    :param objects: names of the scene's objects, then of its point targets
    :param targets: the point targets
    :param fastest_mps: largest speed of a vertex or a target at any time [m/s]
    :param at_rest: the scene at time 0, of which this is another time's; None for that itself
    :param found: what was found of it once, see :mod:`datafactory.paths.merged_scene`
    """

    meshes: tuple[MergedMesh, ...]
    objects: tuple[str, ...]
    targets: tuple[PointTarget, ...] = ()
    fastest_mps: float = 0.0
    at_rest: MergedScene | None = None
    found: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def slabs(self) -> tuple[Material, ...]:
        """What each mesh is made of."""
        return tuple(mesh.slab for mesh in self.meshes)

    def at(self, time_s: float) -> MergedScene:
        """The scene at a time [s]."""
        return _at(self.at_rest or self, float(time_s)) if self.moves else self

    @property
    def moves(self) -> bool:
        """Whether anything is elsewhere at another time."""
        targets = any(target.motion is not None or any(target.velocity) for target in self.targets)
        return targets or any(mesh.moves for mesh in self.meshes)

    @cached_property
    def turned(self) -> Mask:
        """[M] whether a mesh has other vertices at another time, and not only another place."""
        return np.array([bool(mesh.turning) for mesh in self.meshes], dtype=bool)

    @property
    def turns(self) -> bool:
        """Whether any mesh does."""
        return bool(self.turned.any())

    @property
    def shapes(self) -> MergedScene:
        """The scene whose shapes are those of this one, but for shifts: that of time 0, unless something turns."""
        return self if self.at_rest is None or self.turns else self.at_rest

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """[T] index into ``objects`` of every triangle."""
        return np.concatenate([np.zeros(0, np.int32), *(mesh.object_of_triangle for mesh in self.meshes)])

    @cached_property
    def corners(self) -> Real:
        """[T, 3, 3] of all meshes' triangles one after another, world [m], without the meshes' shifts."""
        return np.concatenate([np.zeros((0, 3, 3)), *(mesh.vertices[mesh.triangles] for mesh in self.meshes)])

    @cached_property
    def corner_velocities(self) -> Real:
        """[T, 3, 3] of the corners of what turns, world [m/s]; 0 of all else."""
        velocities = np.zeros_like(self.corners)
        for mesh, first in zip(self.meshes, self.first, strict=False):
            if mesh.turning:
                velocities[first : first + len(mesh.triangles)] = mesh.vertex_velocities[mesh.triangles]
        return velocities

    @cached_property
    def normals(self) -> Real:
        """[T, 3] unit, of all triangles; 0 of one without an area."""
        normal = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return normal / np.where(length > 0.0, length, 1.0)

    @cached_property
    def mesh_of_triangle(self) -> Index:
        """[T] index of the mesh of every triangle, all meshes' triangles one after another."""
        return np.repeat(np.arange(len(self.meshes)), [len(mesh.triangles) for mesh in self.meshes])

    @cached_property
    def first(self) -> Index:
        """[M + 1] where each mesh's triangles begin."""
        return np.cumsum([0, *(len(mesh.triangles) for mesh in self.meshes)])

    @cached_property
    def shifts(self) -> Real:
        """[M, 3] of the meshes [m]."""
        return np.array([mesh.shift for mesh in self.meshes]).reshape(-1, 3)

    @cached_property
    def velocities(self) -> Real:
        """[M, 3] of the meshes, in the world [m/s]."""
        return np.array([mesh.velocity for mesh in self.meshes]).reshape(-1, 3)

    def object_of_target(self, target: NDArray[np.int32]) -> NDArray[np.int32]:
        """[K] index into ``objects`` of the targets of these numbers [K]."""
        return (len(self.objects) - len(self.targets) + target).astype(np.int32)

    def carried(self, triangle: Index, point: Real, mesh: Index) -> Carried:
        """Of points on meshes that turn: which they are, where they are at time 0, and their velocities.

        :param triangle: [n] all meshes' triangles one after another; :param mesh: [n] its mesh
        :param point: [n, 3] in its plane, world [m]
        """
        index = np.flatnonzero(self.turned[mesh])
        own, at_rest = triangle[index], self.at_rest or self
        weights = barycentric(self.corners[own], point[index])
        return Carried(
            index,
            at_rest=np.einsum("nc,nci->ni", weights, at_rest.corners[own]),
            velocity=np.einsum("nc,nci->ni", weights, self.corner_velocities[own]),
        )


@dataclass(frozen=True)
class Carried:
    """Points on meshes that turn.

    :param index: [k] which of the points asked for; :param at_rest: [k, 3] their places at time 0, world [m]
    :param velocity: [k, 3] world [m/s]
    """

    index: Index
    at_rest: Real
    velocity: Real


@lru_cache(maxsize=8)
def _at(scene: MergedScene, time_s: float) -> MergedScene:
    return replace(
        scene,
        meshes=tuple(mesh.at(time_s) for mesh in scene.meshes),
        targets=tuple(target.at(time_s) for target in scene.targets),
        at_rest=scene,
    )


def barycentric(corners: Real, point: Real) -> Real:
    """[n, 3] weights of triangles' corners [n, 3, 3] at points [n, 3] in their planes; 1/3 each without an area."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    towards = point - corners[:, 0]
    normal = np.cross(one, other)
    square = dots(normal, normal)
    flat = square == 0.0
    square = np.where(flat, 1.0, square)
    second = dots(np.cross(towards, other), normal) / square
    third = dots(np.cross(one, towards), normal) / square
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    weights[flat] = 1.0 / 3.0
    return weights


def merge_scene(scene: Scene, materials: MaterialMapping) -> MergedScene:
    """Merge a scene's objects; the order depends on names, velocities and the objects' own order alone."""
    groups: dict[tuple[str, Vector, Hashable], list[int]] = defaultdict(list)
    for index, item in enumerate(scene.objects):
        groups[materials[item.material].name, *_motion_of(item)].append(index)
    meshes = []
    for (_, velocity, body), members in sorted(groups.items(), key=lambda group: (group[0][:2], group[1])):
        parts = [scene.objects[index] for index in members]
        vertices = [part.vertices for part in parts]
        starts = np.cumsum([0] + [len(part) for part in vertices[:-1]])
        track = body if isinstance(body, Track) else None
        every = np.concatenate(vertices)
        mesh = MergedMesh(
            slab=materials[scene.objects[members[0]].material],
            velocity=np.array(velocity),
            vertices=every,
            triangles=np.concatenate([p.triangles + s for p, s in zip(parts, starts, strict=True)]).astype(np.int32),
            object_of_triangle=np.repeat(members, [len(part.triangles) for part in parts]).astype(np.int32),
            track=track,
            body=body,
            turning=tuple(parts) if body is not None and track is None else (),
            vertex_velocities=np.zeros_like(every),
        )
        meshes.append(mesh)
    names = tuple(item.name for item in scene.objects) + tuple(target.name for target in scene.targets)
    speeds = [item.fastest_mps for item in scene.objects] + [target.fastest_mps for target in scene.targets]
    return MergedScene(meshes=tuple(meshes), objects=names, targets=scene.targets, fastest_mps=max(speeds, default=0.0))


def _motion_of(item: SceneObject) -> tuple[Vector, Hashable]:
    """What objects of one rigid body have in common: the velocity at time 0, and the track or the body's name."""
    if isinstance(item.motion, Moving):
        return ZERO, ("turns", item.motion.body)
    return item.velocity, item.motion
