"""A scene from one pose, which every source of echoes is given: the waves that meet its surfaces, and its panes.

Rays meet triangles in float32. Each point is then moved along its ray, in float64, onto the plane of its triangle.

Panes are the slabs on the straight line between radar and point. Every mesh surface is one slab, as in Sionna's own
model: a pane modelled as a box is two panes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from datafactory.paths.candidates import PANE, Candidates
from datafactory.paths.cells import RANGE_CELL_M, U_CELL
from datafactory.paths.columns import Columns
from datafactory.paths.corners import CornerEdges, CornerPoints, corners_of, points_of
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import WedgeEdges, edges_of
from datafactory.paths.facets import reflected_share
from datafactory.paths.feet import NEAREST_M, points_of_reflection
from datafactory.paths.geometry import clear_between, first_hits, mesh_of_shape, ray_margin_m
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.scattering import has_lobes
from datafactory.paths.slabs import Slabs, onto_planes
from datafactory.paths.solver import TraceSettings
from datafactory.scenes.poses import Pose
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Mask, Real, dots, lengths, taken, unit
from shared.radar.front_end import Polarization

EDGES_WITHIN_M = 200.0
"""Farther edges and corners are left out [m]: at -20 dBsm they are 25 dB below a car radar's noise."""
AXES: tuple[Polarization, Polarization] = ("V", "H")
"""Components of a field across a direction: along theta^ and phi^."""

MAXIMUM_CROSSINGS = 8
"""Surfaces on a line that are followed: four panes that are modelled as boxes."""
FADED = 1e-6
"""One-way field behind surfaces that is not followed any further: a hundredth of what counts anywhere."""

FAINTEST = 1e-4
"""One-way amplitude behind surfaces below which a target or a mirror counts as hidden: -160 dB both ways, as behind any
wall."""


@dataclass(frozen=True)
class Waves(Columns):
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
class Hits(Columns):
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

    def clear(self, side: float) -> Real:
        """[n, 3] the points off their surfaces by the ray caster's error: 1 on the side of arrival, -1 behind."""
        return self.point + side * ray_margin_m(lengths(self.point))[:, None] * self.normal


@dataclass(frozen=True, eq=False)
class View:
    """A scene from one pose, at its time, in the radar frame.

    :param geometry: Mitsuba's scene in that frame; its shape ``part-N`` is ``merged.meshes[N]``
    :param merged: at the pose's time
    :param slabs: of the meshes, mid-sweep; materials take their values at 77 GHz whatever the frequency
    """

    geometry: Any
    merged: MergedScene
    slabs: Slabs
    pose: Pose
    settings: TraceSettings

    @property
    def wavelength_m(self) -> float:
        """Mid-sweep."""
        return self.slabs.wavelength_m

    @cached_property
    def rotation(self) -> Real:
        """[3, 3] of the radar in the world."""
        return self.pose.rotation()

    @cached_property
    def moved(self) -> Real:
        """[M, 3] what brings each mesh from its place at time 0 to the radar's origin, world [m]."""
        return self.merged.shifts - np.asarray(self.pose.position)

    @cached_property
    def corners(self) -> Real:
        """[T, 3, 3] of all triangles [m]."""
        return (self.merged.shapes.corners + self.moved[self.merged.mesh_of_triangle][:, None]) @ self.rotation

    @cached_property
    def normals(self) -> Real:
        """[T, 3] unit, of all triangles."""
        return self.merged.shapes.normals @ self.rotation

    @cached_property
    def heights(self) -> Real:
        """[T] of their planes over the radar, along the normals [m]."""
        shapes = self.merged.shapes
        return dots(shapes.normals, shapes.corners[:, 0] + taken(self.moved, self.merged.mesh_of_triangle))

    @cached_property
    def flat(self) -> Index:
        """The triangles that may be flat mirrors: those that sample no curved surface."""
        return curved_surfaces_of(self.merged).flat(len(self.merged.mesh_of_triangle))

    @cached_property
    def feet(self) -> tuple[Index, Real]:
        """The flat triangles [n] that hold the foot of the perpendicular from the radar, and the feet [n, 3] [m]."""
        _, found, foot = points_of_reflection(np.zeros((1, 3)), self.corners[self.flat], self.normals[self.flat])
        return self.flat[found], foot

    @cached_property
    def edges(self) -> WedgeEdges:
        """In range."""
        return edges_of(self.merged).seen_from(self.pose).within(EDGES_WITHIN_M)

    @cached_property
    def corner_edges(self) -> CornerEdges:
        """In range."""
        return corners_of(self.merged).seen_from(self.pose).within(EDGES_WITHIN_M)

    @cached_property
    def corner_points(self) -> CornerPoints:
        """In range."""
        return points_of(self.merged).seen_from(self.pose).within(EDGES_WITHIN_M)

    @cached_property
    def mesh_of_number(self) -> Index:
        """The mesh by the number with which a ray names the shape it met."""
        numbers = mesh_of_shape(self.geometry)
        meshes = np.zeros(max(numbers, default=0) + 1, dtype=np.int64)
        meshes[list(numbers)] = list(numbers.values())
        return meshes

    @cached_property
    def lobes(self) -> Mask:
        """[M] whether what a mesh scatters has lobes."""
        return np.array([has_lobes(slab.pattern) for slab in self.slabs.materials], dtype=bool)

    def velocity(self, triangle: Index, point: Real) -> Real:
        """[n, 3] velocities relative to the radar of points [n, 3] on triangles [n] [m/s]."""
        merged, own, mesh = self.merged, np.asarray(self.pose.velocity), self.merged.mesh_of_triangle[triangle]
        velocity = taken((merged.velocities - own) @ self.rotation, mesh)
        if merged.turns:
            carried = merged.carried(triangle, point @ self.rotation.T + np.asarray(self.pose.position), mesh)
            velocity[carried.index] = (carried.velocity - own) @ self.rotation
        return velocity

    def reflected_share(self, triangle: Index, point: Real, arrival: Real, before_m: Real, after_m: Real) -> Complex:
        """[n] factor of the mirrors' finite size at points [n, 3]; see :func:`.facets.reflected_share`."""
        at_rest = point @ self.rotation.T - self.moved[self.merged.mesh_of_triangle[triangle]]
        towards = arrival @ self.rotation.T
        return reflected_share(self.merged.shapes, triangle, at_rest, towards, before_m, after_m, self.wavelength_m)

    def sight(self, start: Real, end: Real) -> Mask:
        """[K] whether nothing stands between points [K, 3] and [K, 3]."""
        return clear_between(self.geometry, start, end)

    def hit_by(self, waves: Waves) -> tuple[Index, Hits]:
        """The indices of the waves that meet a surface, and where."""
        if not len(waves):  # no array of the ray caster may be empty
            none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
            return none, Hits(nowhere, nowhere, none, none, np.zeros(0), np.zeros(0))
        reach = np.full(len(waves), np.inf)
        met = first_hits(self.geometry, waves.lifted, waves.direction, reach, normals=False)
        valid = np.flatnonzero(met.valid)
        mesh = self.mesh_of_number[met.shape[valid]]
        triangle = self.merged.first[mesh] + met.primitive[valid]
        point, normal, cosine, distance = onto_planes(
            valid, waves.start, waves.lifted, waves.direction, met.distance, triangle, self.normals, self.heights
        )
        good = np.flatnonzero(cosine > 0.0)
        return valid[good], Hits(point, normal, triangle, mesh, cosine, distance).take(good)


def panes_between(
    view: View, points: Real, polarization: Polarization = "V", maximum_crossings: int = MAXIMUM_CROSSINGS
) -> Complex:
    """[K] one-way amplitude along the straight lines from the radar to points, over that of free space.

    The field starts as the unit vector theta^ (V) or phi^ (H) of the radar's spherical coordinates. At every surface it
    is split into the part across the plane of incidence (TE) and the part in it (TM), each is multiplied with its T,
    and what arrives is projected on the first vector again. With one pane that is cos^2(a) T_TE + sin^2(a) T_TM, a the
    angle between the vector and the TE axis. A pane takes the place of air, so that T exp(+j k d cos theta) counts: the
    path's length is that of free space. Bending of the ray (its shift of d tan theta at most) is left out. Out and back
    is the square, by reciprocity, for a target that keeps the polarisation.

    :param points: [K, 3] in the radar frame [m]; surfaces nearer than the ray caster's own error count as behind it
    :param maximum_crossings: of surfaces that are followed; what lies behind more of them has 0
    :return: in the path table's convention
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    distance, direction = lengths(points), unit(points)
    reach = distance - ray_margin_m(distance)
    axis = polarization_axis(direction, polarization)
    field = axis.astype(np.complex128)
    waves, left = Waves.departing(direction, field.copy()), np.arange(len(points))
    for crossing in range(maximum_crossings + 1):
        index, hits = view.hit_by(waves)
        before = np.flatnonzero(waves.length[index] + hits.distance < reach[left[index]])
        index, hits = index[before], hits.take(before)
        waves, left = waves.arrived(index, hits), left[index]
        behind = view.slabs.passed(hits.mesh, waves.direction, hits.normal, waves.field)
        field[left] = behind if crossing < maximum_crossings else 0.0
        # On, from a little behind the surface on the straight line.
        margin = ray_margin_m(waves.length)
        start = waves.start + margin[:, None] * waves.direction
        waves = replace(waves, start=start, lifted=start, length=waves.length + margin, field=behind)
        strong = np.flatnonzero(np.linalg.norm(behind, axis=1) >= FADED)
        waves, left = waves.take(strong), left[strong]
    return np.einsum("ki,ki->k", field, axis).conj()


def polarization_axis(direction: Real, polarization: Polarization) -> Real:
    """[K, 3] theta^ (V, pointing down at the horizon) or phi^ (H, pointing left) of unit directions [K, 3].

    Straight up and down it is undefined; the limit from +x is returned.
    """
    return _axes(np.ascontiguousarray(direction), polarization == "H")


@compiled()
def _axes(direction, horizontal):
    axis = np.empty((len(direction), 3))
    for k in range(len(direction)):
        x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
        across = np.sqrt(x * x + y * y)
        cosine, sine = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
        if horizontal:
            axis[k, 0], axis[k, 1], axis[k, 2] = -sine, cosine, 0.0
        else:
            axis[k, 0], axis[k, 1], axis[k, 2] = z * cosine, z * sine, -across
    return axis


def pane_candidates(view: View) -> Candidates:
    """Of the panes ahead: what stands behind one may be a mirror, so that no echo exceeds T^2 lambda / (8 pi R), T the
    largest that the slab lets through at any angle.

    A triangle's direction is that of the corner, middle of a side or centre that lies nearest to boresight; R is no
    more than the distance of any of its points. Of those in one cell of range and u the strongest stands for all.
    """
    corners, largest = [np.zeros((0, 3, 3))], [np.zeros(0)]
    for number in np.flatnonzero(view.slabs.lets_through):
        mesh = view.merged.meshes[number]
        corners.append(mesh.seen_from(view.pose)[mesh.triangles].astype(np.float64))
        largest.append(np.full(len(mesh.triangles), view.slabs.most_passed[number]))
    corner, passed = np.concatenate(corners), np.concatenate(largest)
    ahead = np.flatnonzero((corner[:, :, 0] > 0.0).any(axis=1))
    corner, passed = corner[ahead], passed[ahead]
    middle, centre = 0.5 * (corner + np.roll(corner, 1, axis=1)), corner.mean(axis=1, keepdims=True)
    places = np.concatenate([corner, middle, centre], axis=1)
    distance = np.linalg.norm(places, axis=2)
    best = np.argmax(places[:, :, 0] / np.maximum(distance, NEAREST_M), axis=1)
    half = 0.5 * np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    nearest = np.maximum(distance.min(axis=1) - half, NEAREST_M)
    power = (passed**2 * view.wavelength_m / (8.0 * np.pi * nearest)) ** 2
    place = places[np.arange(len(corner)), best]
    u = place[:, 1] / np.maximum(lengths(place), NEAREST_M)
    cell = 1024.0 * np.rint(nearest / RANGE_CELL_M) + np.rint(u / U_CELL)
    order = np.lexsort((-power, cell))
    kept = order[np.unique(cell[order], return_index=True)[1]]
    return Candidates.of(PANE, place[kept], power[kept], nearest[kept])
