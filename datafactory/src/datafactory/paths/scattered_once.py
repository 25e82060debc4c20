"""Echoes that are scattered once, by the surface they reach last: every ray scatters wherever it arrives.

The solver follows one kind of bounce a ray and surface. It lets a ray scatter with a probability near S^2, so that one
in eleven rays on concrete (S = 0.3) becomes an echo, with eleven times the power. Here every ray scatters at the
surface that the sensor sees, and at the surfaces that it reaches through mirrors; the expectation of the power is the
same. A ray stands for the solid angle Omega of its tube, which plane mirrors keep. Of unit power on isotropic antennas
the tube holds Omega / (4 pi). The surface takes S^2 |Gamma|^2 of it, spreads it with the pattern f
(:mod:`datafactory.paths.scattering`), and the RX, r away, has the aperture lambda^2 / (4 pi):

    A = lambda / (4 pi r) S |Gamma| sqrt(f Omega) e,    |Gamma| = |R e_i| / |e_i|,

with R the slab's reflection of the arriving field e_i (:mod:`datafactory.paths.panes`), which has the factor
sqrt(1 - S^2) R of every mirror before, and e its part along the RX's polarisation. The scattered field keeps its
components along theta^ and phi^: Sionna's model with K_x = 0. That is lambda^2 / (4 pi)^3 times the integral of
sigma^0 / R^4 over the surface, sigma^0 = 4 pi S^2 |Gamma|^2 f cos(theta) (:func:`lambertian_sigma0` of the material
table).

The first surface may be seen through one pane, out and back, with the pane's transmission both ways.

Rays meet triangles in float32. Each point is then moved along its ray, in float64, onto the plane of its triangle.
The surface's phase is applied afterwards (:mod:`datafactory.paths.trace`), and so is the fan's solid angle: Omega is
4 pi / N here.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.facets import mirrors_of
from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.panes import (
    clear_between,
    field_behind_slab,
    mesh_of_shape,
    polarization_axis,
    ray_margin_m,
    rays_of,
    slab_reflection,
)
from datafactory.paths.rays import RayFan
from datafactory.paths.scattering import scattered_share
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.table import DIFFUSE, SPECULAR
from datafactory.paths.targets import FAINTEST
from datafactory.paths.unfold import unit
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.units import SPEED_OF_LIGHT

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

CLOSEST_M = 0.01
"""Nearer surfaces do not scatter: the antennas' own size matters there. Single mirrors have the same bound."""
ON_ITS_PLANE = 1e-2
"""A point may move by this share of its distance onto its triangle's plane; by more where the plane is seen edge on,
and then the ray caster's own distance is kept.
"""
MISSED_POLARIZATION = 1e-9
"""Share of a field along the RX's polarisation below which it is rounding: the echo of a surface has no part across."""


@dataclass(frozen=True)
class _Waves:
    """n waves on their way.

    :param start: [n, 3] [m]; :param lifted: [n, 3] the same clear of the surface that the wave left, for float32
    :param direction: [n, 3] unit
    :param field: [n, 3] over that of the TX, without spreading
    :param bounced: [n, b, 3] vertices so far; :param triangles: [n, b] theirs
    """

    start: Real
    lifted: Real
    direction: Real
    field: Complex
    bounced: Real
    triangles: NDArray[np.int64]

    def take(self, index: NDArray) -> _Waves:
        return _Waves(**{item.name: getattr(self, item.name)[index] for item in fields(self)})


@dataclass(frozen=True)
class _Hits:
    """Where n waves arrived.

    :param point: [n, 3] [m]; :param normal: [n, 3] unit, on the side of arrival
    :param triangle: [n] index into the merged scene's triangles; :param mesh: [n]
    :param cosine: [n] of the angle of incidence
    """

    point: Real
    normal: Real
    triangle: NDArray[np.int64]
    mesh: NDArray[np.int64]
    cosine: Real

    def take(self, index: NDArray) -> _Hits:
        return _Hits(**{item.name: getattr(self, item.name)[index] for item in fields(self)})


class _Surfaces:
    """The surfaces of a scene from one pose, in the radar frame."""

    def __init__(
        self, geometry: Any, merged_scene: MergedScene, materials: MaterialMapping, pose: Pose, frequency_hz: float
    ) -> None:
        meshes = merged_scene.meshes
        counts = [len(mesh.triangles) for mesh in meshes]
        self.geometry, self.frequency_hz = geometry, frequency_hz
        self.slabs = slabs_of(merged_scene, materials)
        self.mirrors, self.rotation = mirrors_of(merged_scene), pose.rotation()
        self.first = np.cumsum([0, *counts])
        velocity = np.array([mesh.velocity for mesh in meshes]).reshape(-1, 3)
        self.moved = velocity * pose.time_s - np.asarray(pose.position)
        self.velocity = (velocity - np.asarray(pose.velocity)) @ self.rotation
        self.object_of_triangle = np.concatenate([mesh.object_of_triangle for mesh in meshes]).astype(np.int64)
        self.mesh_of_triangle = np.repeat(np.arange(len(meshes)), counts)
        self.mesh_number = mesh_of_shape(geometry)

    def hit_by(self, waves: _Waves) -> tuple[_Waves, _Hits]:
        """The waves that meet a surface, and where."""
        import drjit as dr
        import mitsuba as mi

        endless = np.full(len(waves.start), np.inf)
        met = self.geometry.ray_intersect(rays_of(waves.lifted, waves.direction, endless))
        valid = np.flatnonzero(met.is_valid().numpy())
        shape = mi.UInt32(dr.reinterpret_array(mi.UInt32, met.shape)).numpy()[valid]
        mesh = np.zeros(len(valid), dtype=np.int64)
        for number, index in self.mesh_number.items():
            mesh[shape == number] = index
        triangle = self.first[mesh] + met.prim_index.numpy()[valid].astype(np.int64)
        waves, distance = waves.take(valid), met.t.numpy()[valid].astype(np.float64)
        normal = (self.mirrors.normals @ self.rotation)[triangle]
        corner = (self.mirrors.corners[triangle, 0] + self.moved[mesh]) @ self.rotation
        slope = np.einsum("ki,ki->k", normal, waves.direction)
        height = np.einsum("ki,ki->k", normal, corner - waves.start)
        exact = np.divide(height, slope, out=np.full_like(slope, np.inf), where=slope != 0.0)
        distance = np.where(np.abs(exact - distance) <= ON_ITS_PLANE * distance, exact, distance)
        facing = np.where(slope > 0.0, -1.0, 1.0)[:, None] * normal
        point = waves.start + distance[:, None] * waves.direction
        hits = _Hits(point, facing, triangle, mesh, np.clip(np.abs(slope), 1e-9, 1.0))
        good = np.flatnonzero((distance > 0.0) & (np.linalg.norm(normal, axis=1) > 0.5))
        return waves.take(good), hits.take(good)

    def by_mesh(self, hits: _Hits):
        """(material, indices) of the hits on each mesh."""
        for mesh in np.unique(hits.mesh):
            yield self.slabs[mesh], np.flatnonzero(hits.mesh == mesh)

    def reflected(self, waves: _Waves, hits: _Hits) -> tuple[Real, Complex]:
        """Directions [n, 3] and fields [n, 3] of the waves that a mirror of this material would send on."""
        onward = waves.direction + 2.0 * hits.cosine[:, None] * hits.normal
        across = np.cross(waves.direction, hits.normal)
        steep = np.linalg.norm(across, axis=1) < 1e-6  # R_TE = -R_TM there: any axis will do
        across[steep] = polarization_axis(waves.direction[steep], "H")
        across = unit(across)
        te = np.einsum("ki,ki->k", waves.field, across)
        tm = np.einsum("ki,ki->k", waves.field, np.cross(waves.direction, across))
        for slab, here in self.by_mesh(hits):
            r_te, r_tm = slab_reflection(
                slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, self.frequency_hz,
                hits.cosine[here],
            )  # fmt: skip
            te[here] *= r_te
            tm[here] *= r_tm
        return onward, te[:, None] * across + tm[:, None] * np.cross(onward, across)

    def passed(self, waves: _Waves, hits: _Hits, field: Complex) -> Complex:
        """[n, 3] ``field`` behind the surfaces."""
        behind = np.empty_like(field)
        for slab, here in self.by_mesh(hits):
            behind[here] = field_behind_slab(
                slab, self.frequency_hz, waves.direction[here], hits.normal[here], field[here]
            )
        return behind


def scattered_once(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
    fan: RayFan,
) -> list[Bundle]:
    """The echoes of a frame that are scattered once, at their last bounce: for each number of bounces, by ray.

    :param geometry: Mitsuba's scene in the radar frame
    :param frequency_hz: mid-sweep; materials take their values at 77 GHz whatever it is
    """
    if not settings.diffuse or not merged_scene.meshes:
        return []
    surfaces = _Surfaces(geometry, merged_scene, materials, pose, frequency_hz)
    direction = fan.directions()
    count = len(direction)
    transmitted = polarization_axis(direction, settings.polarization[0]).astype(np.complex128)
    here, none = np.zeros((count, 3)), np.zeros((count, 0), dtype=np.int64)
    waves = _Waves(here, here, direction, transmitted, np.zeros((count, 0, 3)), none)
    bundles = []
    for bounce in range(settings.depth):
        waves, hits = surfaces.hit_by(waves)
        onward, reflected = surfaces.reflected(waves, hits)
        found = [_echoes(surfaces, waves, hits, reflected, settings, count)]
        if bounce == 0 and settings.refraction:
            found.append(_echoes_behind_panes(surfaces, waves, hits, settings, count))
        bundles.append(Bundle.joined(found))
        if bounce + 1 == settings.depth or not settings.specular:
            break
        coefficient = np.array([slab.scattering_coefficient for slab in surfaces.slabs])[hits.mesh]
        waves = _Waves(
            hits.point,
            _clear_of(hits, 1.0),
            onward,
            reflected * np.sqrt(1.0 - coefficient**2)[:, None],
            np.concatenate([waves.bounced, hits.point[:, None]], axis=1),
            np.concatenate([waves.triangles, hits.triangle[:, None]], axis=1),
        ).take(np.flatnonzero(coefficient < 1.0))
    return bundles


def _clear_of(hits: _Hits, side: float) -> Real:
    """[n, 3] the points off their surfaces by the ray caster's error: 1 on the side of arrival, -1 behind."""
    return hits.point + side * ray_margin_m(np.linalg.norm(hits.point, axis=1))[:, None] * hits.normal


def _echoes(
    surfaces: _Surfaces, waves: _Waves, hits: _Hits, reflected: Complex, settings: TraceSettings, rays: int
) -> Bundle:
    """What the surfaces scatter back to the RX, where it sees them."""
    home = -unit(hits.point)
    first = waves.bounced.shape[1] == 0
    seen = np.linalg.norm(hits.point, axis=1) >= CLOSEST_M
    if not first:
        seen &= np.einsum("ki,ki->k", hits.normal, home) > 0.0
        index = np.flatnonzero(seen)
        seen[index] = clear_between(surfaces.geometry, hits.point[index], np.zeros(3))
    index = np.flatnonzero(seen)
    waves, hits, home = waves.take(index), hits.take(index), home[index]
    share = np.linalg.norm(reflected[index], axis=1)
    share /= np.maximum(np.linalg.norm(waves.field, axis=1), np.finfo(float).tiny)
    scattered = _turned_back(waves.field, waves.direction, home) * share[:, None]
    return _bundle(surfaces, waves, hits, scattered, home, settings, rays, 0)


def _turned_back(field: Complex, arrival: Real, departure: Real) -> Complex:
    """[n, 3] the field with its components along theta^ and phi^ of the arrival along those of the departure."""
    total = np.zeros_like(field)
    for which in ("V", "H"):
        component = np.einsum("ki,ki->k", field, polarization_axis(arrival, which))
        total += component[:, None] * polarization_axis(departure, which)
    return total


def _echoes_behind_panes(surfaces: _Surfaces, waves: _Waves, hits: _Hits, settings: TraceSettings, rays: int) -> Bundle:
    """What is scattered back through the first surface by what stands behind it."""
    field = surfaces.passed(waves, hits, waves.field)
    through = np.flatnonzero(np.linalg.norm(field, axis=1) > FAINTEST)
    pane_waves, panes = waves.take(through), hits.take(through)
    behind = replace(pane_waves, start=panes.point, lifted=_clear_of(panes, -1.0), field=field[through])
    numbered = replace(behind, bounced=panes.point[:, None], triangles=np.arange(len(through))[:, None])
    numbered, beyond = surfaces.hit_by(numbered)
    which = numbered.triangles[:, 0]
    panes, behind = panes.take(which), behind.take(which)
    home = -behind.direction
    _, reflected = surfaces.reflected(behind, beyond)
    share = np.linalg.norm(reflected, axis=1) / np.linalg.norm(behind.field, axis=1)
    scattered = _turned_back(behind.field, behind.direction, home) * share[:, None]
    return _bundle(surfaces, behind, beyond, surfaces.passed(behind, panes, scattered), home, settings, rays, 2)


def _bundle(
    surfaces: _Surfaces, waves: _Waves, hits: _Hits, scattered: Complex, home: Real, settings: TraceSettings,
    rays: int, crossings: int,
) -> Bundle:  # fmt: skip
    """The paths of the scattered fields [n, 3] that arrive along ``home``; those that the RX does not hear are left
    out.
    """
    wavelength = SPEED_OF_LIGHT / surfaces.frequency_hz
    heard = np.einsum("ki,ki->k", scattered, polarization_axis(-home, settings.polarization[1]))
    factor = np.zeros(len(heard))
    for slab, here in surfaces.by_mesh(hits):
        f = scattered_share(slab.pattern, waves.direction[here], home[here], hits.normal[here])
        factor[here] = slab.scattering_coefficient * np.sqrt(f * 4.0 * np.pi / rays)
    amplitude = np.conj(heard) * factor * wavelength / (4.0 * np.pi * np.linalg.norm(hits.point, axis=1))
    floor = MISSED_POLARIZATION * np.linalg.norm(scattered, axis=1)
    kept = np.flatnonzero((factor > 0.0) & (np.abs(heard) > floor))
    triangles = np.concatenate([waves.triangles, hits.triangle[:, None]], axis=1)[kept]
    kinds = np.full(triangles.shape, SPECULAR, dtype=np.int64)
    kinds[:, -1] = DIFFUSE
    return Bundle(
        vertices=np.concatenate([waves.bounced, hits.point[:, None]], axis=1)[kept],
        interactions=kinds,
        objects=surfaces.object_of_triangle[triangles],
        triangles=triangles,
        velocities=surfaces.velocity[surfaces.mesh_of_triangle[triangles]],
        crossings=np.full(len(kept), crossings, dtype=np.int64),
        amplitude=amplitude[kept],
    )
