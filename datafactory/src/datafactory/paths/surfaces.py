"""The surfaces of a scene from one pose, and the waves that meet them.

Rays meet triangles in float32. Each point is then moved along its ray, in float64, onto the plane of its triangle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns
from datafactory.paths.facets import mirrors_of
from datafactory.paths.geometry import mesh_of_shape
from datafactory.paths.merged_scene import MergedScene, slabs_of, velocities_on
from datafactory.paths.ray_hits import first_hits
from datafactory.paths.scattering import has_lobes
from datafactory.paths.slabs import lets_through, transmission_over_air
from datafactory.paths.smooth_faces import reflection_by_slabs
from datafactory.paths.wave_steps import onto_planes
from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.vectors import dots, taken

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]


class Rising(Columns):
    """Taken by rising indices alone: as many as there are, are all of them."""

    def take(self, index: Index) -> Self:
        """Those at these indices, which rise."""
        return self if len(index) == len(self) else super().take(index)


@dataclass(frozen=True)
class Waves(Rising):
    """n waves on their way.

    :param start: [n, 3] [m]; :param lifted: [n, 3] the same clear of the surface that the wave left, for float32
    :param direction: [n, 3] unit
    :param field: [n, 3] over that of the TX, without spreading
    :param length: [n] of the way so far [m]; :param rate: [n] its change [m/s]
    :param bounced: [n, b, 3] vertices so far; :param triangles: [n, b] theirs
    """

    start: Real
    lifted: Real
    direction: Real
    field: Complex
    length: Real
    rate: Real
    bounced: Real
    triangles: Index

    @staticmethod
    def departing(direction: Real, field: Complex) -> Waves:
        """Waves that leave the sensor, in ``direction`` [n, 3] with ``field`` [n, 3]."""
        here, none = np.zeros_like(direction), np.zeros((len(direction), 0), dtype=np.int64)
        return Waves(here, here, direction, field, here[:, 0], here[:, 0], np.zeros((*none.shape, 3)), none)

    def arrived(self, index: Index, hits: Hits) -> Waves:
        """Those at these indices, which rise, where they hit."""
        own = {
            name: taken(getattr(self, name), index) for name in ("direction", "field", "rate", "bounced", "triangles")
        }
        return Waves(start=hits.point, lifted=hits.point, length=self.length[index] + hits.distance, **own)


@dataclass(frozen=True)
class Hits(Rising):
    """Where n waves arrived.

    :param point: [n, 3] [m]; :param normal: [n, 3] unit, on the side of arrival
    :param triangle: [n] index into the merged scene's triangles; :param mesh: [n]
    :param cosine: [n] of the angle of incidence; :param distance: [n] of the last leg [m]
    """

    point: Real
    normal: Real
    triangle: Index
    mesh: Index
    cosine: Real
    distance: Real


class Surfaces:
    """The surfaces of a scene from one pose, in the radar frame.

    :param geometry: Mitsuba's scene in the radar frame
    :param frequency_hz: mid-sweep; materials take their values at 77 GHz whatever it is
    """

    def __init__(
        self, geometry: Any, merged_scene: MergedScene, materials: MaterialMapping, pose: Pose, frequency_hz: float
    ) -> None:
        meshes = merged_scene.meshes
        counts = [len(mesh.triangles) for mesh in meshes]
        rotation, mirrors = pose.rotation(), mirrors_of(merged_scene)
        velocity = np.array([mesh.velocity for mesh in meshes])
        moved = np.array([mesh.shift for mesh in meshes]) - np.asarray(pose.position)
        self.geometry, self.frequency_hz = geometry, frequency_hz
        self.slabs = slabs_of(merged_scene, materials)
        self.scattering = np.array([slab.scattering_coefficient for slab in self.slabs])
        self.lobes = np.array([has_lobes(slab.pattern) for slab in self.slabs])
        self.first = np.cumsum([0, *counts])
        self.mesh_of_triangle = merged_scene.mesh_of_triangle
        self.object_of_triangle = np.concatenate([mesh.object_of_triangle for mesh in meshes]).astype(np.int64)
        self._velocity = (velocity - np.asarray(pose.velocity)) @ rotation
        self._merged_scene, self._pose = merged_scene, pose
        self.normals = mirrors.normals @ rotation
        self.heights = dots(mirrors.normals, mirrors.corners[:, 0] + taken(moved, self.mesh_of_triangle))
        numbers = mesh_of_shape(geometry)
        self.mesh_of_number = np.zeros(max(numbers, default=0) + 1, dtype=np.int64)
        self.mesh_of_number[list(numbers)] = list(numbers.values())

    def velocity(self, triangle: Index, point: Real) -> Real:
        """[n, 3] velocities relative to the radar of points [n, 3] on triangles [n] [m/s]."""
        return velocities_on(self._merged_scene, self._pose, self._velocity, triangle, point)

    def hit_by(self, waves: Waves) -> tuple[Index, Hits]:
        """The indices of the waves that meet a surface, and where."""
        if not len(waves.start):  # no array of the ray caster may be empty
            none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
            return none, Hits(nowhere, nowhere, none, none, np.zeros(0), np.zeros(0))
        reach = np.full(len(waves.start), np.inf)
        met = first_hits(self.geometry, waves.lifted, waves.direction, reach, normals=False)
        valid = np.flatnonzero(met.valid)
        mesh = self.mesh_of_number[met.shape[valid]]
        triangle = self.first[mesh] + met.primitive[valid]
        point, normal, cosine, distance = onto_planes(
            valid, waves.start, waves.direction, met.distance, triangle, self.normals, self.heights
        )
        good = np.flatnonzero(cosine > 0.0)
        return valid[good], Hits(point, normal, triangle, mesh, cosine, distance).take(good)

    def by_mesh(self, mesh: Index) -> Iterator[tuple[Material, Index]]:
        """(material, indices) of the hits on each mesh."""
        for number in np.flatnonzero(np.bincount(mesh)).tolist():
            yield self.slabs[number], np.flatnonzero(mesh == number)

    def reflection(self, hits: Hits) -> tuple[Complex, Complex]:
        """R of the surfaces, TE [n] and TM [n], were they smooth."""
        return reflection_by_slabs(self.slabs, hits.mesh, self.frequency_hz, hits.cosine)

    def transmission(self, hits: Hits) -> tuple[Complex, Complex]:
        """T of the surfaces, TE [n] and TM [n], over that of the air in their place; the same in both senses."""
        te, tm = np.empty((2, len(hits.mesh)), dtype=np.complex128)
        for slab, here in self.by_mesh(hits.mesh):
            te[here], tm[here] = transmission_over_air(slab, self.frequency_hz, hits.cosine[here])
        return te, tm

    def lets_through(self) -> NDArray[np.bool_]:
        """[M] whether surfaces behind the meshes' slabs are heard."""
        return np.array([lets_through(slab, self.frequency_hz) for slab in self.slabs])
