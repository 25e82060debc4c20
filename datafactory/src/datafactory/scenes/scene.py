"""The scene as plain float64 arrays: every reader returns one, and every later step takes one.

This module depends on neither USD nor Mitsuba nor Sionna. Readers convert their input to metres, z up and one world
frame. Objects are one mesh each, and stand where they are at time 0; :mod:`datafactory.scenes.motion` says where they
are at other times, and ``at`` of an object and of a target asks it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain
from datafactory.scenes.motion import Instant, Motion, Moving, Track, Vector, drift, fastest_mps, triple, upright_axes
from datafactory.scenes.targets.models import RcsModel
from datafactory.scenes.things import Label, Population
from shared.physics.errors import Told

ZERO = (0.0, 0.0, 0.0)
LARGEST_RCS_DBSM = 200.0
"""Of a cross section that is stated, either sign [dBsm]: a large ship has 80, an insect -60."""
WORLD_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class SceneObject:
    """One triangle mesh of one material, at time 0.

    :param name: unique within the scene, e.g. the prim path
    :param vertices: [V, 3] world coordinates [m], float64
    :param triangles: [T, 3] vertex indices, int32; every triangle has a positive area
    :param material: the name that the source gave its material, e.g. ``"mat-itu_concrete"``; "" where it gave none
    :param velocity: world velocity [m/s] at time 0; of what turns or changes its shape, that of its vertices' mean
    :param motion: how it moves; None: straight on with ``velocity``
    :param label: the thing that it is a part of, for boxes; None where the source does not say
    :param local: of what turns or changes its shape, points [P, 3] in its own coordinates, in any precision, and which
        of them [V] are its vertices; None of everything else
    """

    name: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    material: str = ""
    velocity: tuple[float, float, float] = ZERO
    motion: Motion | None = None
    label: Label | None = field(default=None, repr=False)
    local: tuple[NDArray[np.floating], NDArray[np.integer]] | None = field(default=None, repr=False)

    @property
    def moves(self) -> bool:
        return self.motion is not None or any(component != 0.0 for component in self.velocity)

    def at(self, time_s: float) -> Instant:
        """Where the vertices are at a time [s], and each one's velocity."""
        if isinstance(self.motion, Moving):
            assert self.local is not None
            return self.motion.at(*self.local, time_s)
        shift, velocity = drift(self.velocity, self.motion, time_s)
        vertices = self.vertices + shift
        return Instant(vertices, np.broadcast_to(velocity, vertices.shape))

    @property
    def fastest_mps(self) -> float:
        """Largest speed of a vertex at any time [m/s]."""
        return fastest_mps(self.velocity, self.motion, *(self.local or ()))

    def as_it_moves(self) -> SceneObject:
        """The same with the velocity that follows from its motion, where it has one."""
        if self.motion is None:
            return self
        own = self.motion.at(0.0)[1] if isinstance(self.motion, Track) else self.at(0.0).velocities.mean(axis=0)
        return replace(self, velocity=triple(own))


@dataclass(frozen=True)
class PointTarget:
    """A target with a radar cross section in place of a mesh.

    :param name: unique within the scene
    :param position: world position [m] at time 0
    :param rcs_dbsm: radar cross section [dB relative to 1 m^2]; of a model its nominal one, for lists
    :param velocity: world velocity [m/s]
    :param model: where and how strongly the target echoes, by aspect; None for ``rcs_dbsm`` from everywhere
    :param axes: x, y and z of the model's frame in the world, right-handed unit vectors
    :param motion: how it moves; None: straight on with ``velocity``
    :param spin: rate of turn in the world [rad/s]
    :param occupied: lower and upper corner along ``axes`` [m] of what a target without a model stands for, where known
    :param label: the thing that it is, for boxes; None where the source does not say
    """

    name: str
    position: Vector
    rcs_dbsm: float
    velocity: Vector = ZERO
    model: RcsModel | None = None
    axes: tuple[Vector, Vector, Vector] = WORLD_AXES
    motion: Motion | None = field(default=None, repr=False)
    spin: Vector = field(default=ZERO, repr=False)
    occupied: tuple[Vector, Vector] | None = field(default=None, repr=False)
    label: Label | None = field(default=None, repr=False)

    @property
    def moves(self) -> bool:
        return self.motion is not None or any(self.velocity)

    @property
    def extent(self) -> tuple[Vector, Vector]:
        """Lower and upper corner along ``axes`` of what it stands for [m]; twice its place where no size is known."""
        return self.model.extent_m if self.model is not None else self.occupied or (ZERO, ZERO)

    def at(self, time_s: float) -> PointTarget:
        """The target as it is at a time [s]."""
        if not isinstance(self.motion, Moving):
            shift, rate = drift(self.velocity, self.motion, time_s)
            return replace(self, position=triple(np.array(self.position) + shift), velocity=triple(rate))
        matrix, rate = self.motion.chain.at(time_s)
        axes, spin = _turned_axes(self.axes, self.motion.chain, time_s)
        position, velocity = triple(matrix[:3, 3]), triple(rate[:3, 3])
        return replace(self, position=position, velocity=velocity, axes=axes, spin=spin)

    @property
    def fastest_mps(self) -> float:
        """Largest speed of its origin at any time [m/s]."""
        return fastest_mps(self.velocity, self.motion)


@dataclass(frozen=True)
class Scene(Told):
    """The contents of a scene file, in metres and z up.

    :param name: short name, used in the dataset's ``scene`` column
    :param objects: the meshes, in the source's order
    :param targets: point targets with a radar cross section
    :param source: the path or ``sionna:NAME`` it was read from
    :param warnings: what the reader ignored, with counts, e.g. ``"3 prims of type Curves ignored"``
    :param stated: name of a material as its objects have it -> the substance that the file says it is, e.g. ``"metal"``
    :param population: what was put into it besides, of which the objects and targets are among these; None of a scene
        as it was read
    :param variants: with which it was read, as ``allow_missing``, see
        :class:`datafactory.scenes.readers.common.Reading`
    """

    name: str
    objects: tuple[SceneObject, ...]
    targets: tuple[PointTarget, ...] = ()
    source: str = ""
    warnings: tuple[str, ...] = field(default=())
    stated: Mapping[str, str] = field(default_factory=dict)
    population: Population | None = None
    variants: tuple[tuple[str, str], ...] = ()
    allow_missing: bool = False

    def __str__(self) -> str:
        moving = sum(item.moves for item in self.objects) + sum(target.moves for target in self.targets)
        told = [
            f"scene {self.name}: {len(self.objects)} objects of {self.triangle_count} triangles, "
            f"{len(self.targets)} point targets; {moving} of them move"
        ]
        if self.objects or self.targets:
            lower, upper = self.bounds()
            axes = zip("xyz", lower, upper, strict=True)
            told.append("spans " + ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in axes) + " m")
        if self.source:
            told.append(f"read from {self.source}")
        if self.warnings:
            others = f"; {len(self.warnings) - 1} more in warnings" if len(self.warnings) > 1 else ""
            told.append(f"warned: {self.warnings[0]}{others}")
        return "\n".join(told)

    @property
    def triangle_count(self) -> int:
        return sum(len(item.triangles) for item in self.objects)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner [m] of everything in the scene, each [3]."""
        corners = [np.array([target.position, target.position]) for target in self.targets]
        corners += [np.stack([item.vertices.min(axis=0), item.vertices.max(axis=0)]) for item in self.objects]
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
        every: list[SceneObject | PointTarget] = [*self.objects, *self.targets]
        for part in every:
            if part.motion is not None:
                digest.update(part.name.encode() + part.motion.fingerprint())
        for part in every:
            if part.label is not None:
                digest.update(part.name.encode() + part.label.fingerprint())
        for target in self.targets:
            if target.occupied is not None:
                digest.update(repr((target.name, target.occupied)).encode())
        for name, substance in self.stated.items():
            digest.update(repr((name, substance)).encode())
        return digest.hexdigest()


def _turned_axes(
    axes: tuple[Vector, Vector, Vector], chain: Chain, time_s: float
) -> tuple[tuple[Vector, Vector, Vector], Vector]:
    """A model's axes, which are ``axes`` at time 0, and its rate of turn [rad/s] at a time."""
    home, _ = chain.at(0.0)
    matrix, rate = chain.at(time_s)
    try:
        turn = matrix[:3, :3] @ np.linalg.inv(home[:3, :3])
        whirl = rate[:3, :3] @ np.linalg.inv(matrix[:3, :3])
    except np.linalg.LinAlgError:  # flat at one of the two times
        return axes, ZERO
    with np.errstate(over="ignore", invalid="ignore"):  # nearly flat: squares of its inverse are not finite
        turned = upright_axes(turn @ np.array(axes[0]), turn @ np.array(axes[2]))
    spin = 0.5 * np.array([whirl[2, 1] - whirl[1, 2], whirl[0, 2] - whirl[2, 0], whirl[1, 0] - whirl[0, 1]])
    return turned or axes, triple(spin)
