"""Single mirrors, found by the feet of their perpendiculars: all of them, whatever the number of rays.

A facet gives a single specular echo where it contains the foot of the perpendicular from the radar. The solver finds
that echo only if a ray hits the facet, so that a small facet appears in some realisations and not in others. This
module computes the foot on every triangle in the front half space, into which the rays are sent. The amplitude is

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) F,

with Gamma the slab's reflection coefficient at normal incidence (ITU-R P.2040-3, eq. (37)), S the scattering
coefficient, and F the factor of the facet's size (:mod:`datafactory.paths.facets`). The echo has no cross-polarised
part.

Triangles that sample a curved surface have no feet here; the surface has (:mod:`datafactory.paths.curved_mirrors`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.facets import mirrors_of, reflected_share
from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.panes import panes_between
from datafactory.paths.ray_hits import clear_between
from datafactory.paths.slabs import slab_reflection
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import REFRACTED, SPECULAR, SpecularPaths
from datafactory.paths.targets import FAINTEST
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.units import SPEED_OF_LIGHT

Real = NDArray[np.float64]

INSIDE = 1e-9
"""Barycentric coordinates may fall below zero by this: a foot on an edge belongs to both triangles, and counts once."""
CLOSEST_M = 0.01
"""Nearer mirrors are left out, as the solver does: the antennas' own size matters there."""
AHEAD_M = 1e-6
"""A foot straight below the radar lies at x = 0, apart from rounding, and counts as ahead."""


def single_mirrors(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
) -> tuple[SpecularPaths, dict[str, int]]:
    """All single specular echoes of a frame, and how many are hidden.

    :param geometry: Mitsuba's scene in the radar frame
    """
    if not merged_scene.meshes or settings.polarization[0] != settings.polarization[1]:
        return SpecularPaths.none(), {}
    mirrors, rotation, wavelength = mirrors_of(merged_scene), pose.rotation(), SPEED_OF_LIGHT / frequency_hz
    mesh = merged_scene.mesh_of_triangle
    velocity = np.array([item.velocity for item in merged_scene.meshes])[mesh]
    moved = np.array([item.shift for item in merged_scene.meshes])[mesh] - np.asarray(pose.position)
    flat = curved_surfaces_of(merged_scene).flat(len(mesh))
    found, foot = _perpendicular_feet(
        (mirrors.corners[flat] + moved[flat, None]) @ rotation, mirrors.normals[flat] @ rotation
    )
    triangle = flat[found]
    passed, kinds = way_and_back(geometry, merged_scene, materials, frequency_hz, settings, foot)
    seen = np.flatnonzero(passed != 0.0)
    hidden = len(triangle) - len(seen)
    triangle, foot, passed, kinds = triangle[seen], foot[seen], passed[seen], kinds[seen]
    range_m = np.linalg.norm(foot, axis=1)
    amplitude = plane_amplitude(merged_scene, materials, frequency_hz, mesh[triangle], range_m) * passed
    if settings.finite_mirrors:
        at_rest = mirrors.corners[triangle, 0]
        normal = mirrors.normals[triangle]
        world = foot @ rotation.T - moved[triangle]
        world -= np.einsum("ki,ki->k", world - at_rest, normal)[:, None] * normal
        amplitude *= reflected_share(mirrors, triangle, world, foot @ rotation.T, range_m, range_m, wavelength)
    objects = np.concatenate([item.object_of_triangle for item in merged_scene.meshes])
    direction = foot / range_m[:, None]
    at_foot = velocity[triangle]
    carried = merged_scene.carried(triangle, foot @ rotation.T - moved[triangle], mesh[triangle])
    at_foot[carried.index] = carried.velocity
    relative = (at_foot - np.asarray(pose.velocity)) @ rotation
    approach = np.einsum("ki,ki->k", direction, relative)
    image_velocity = 2.0 * approach[:, None] * direction
    turning = _rates_of_normals(merged_scene, triangle[carried.index], mesh[triangle[carried.index]]) @ rotation
    side = np.sign(np.einsum("ki,ki->k", mirrors.normals[triangle[carried.index]] @ rotation, direction[carried.index]))
    image_velocity[carried.index] += 2.0 * (side * range_m[carried.index])[:, None] * turning
    axes = np.eye(3) - 2.0 * direction[:, :, None] * direction[:, None, :]
    owner = objects[triangle].astype(np.int32)
    return SpecularPaths.of(2.0 * foot, image_velocity, axes, amplitude, owner, kinds), {"mirrors_hidden": hidden}


def way_and_back(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    frequency_hz: float,
    settings: TraceSettings,
    point: Real,
) -> tuple[NDArray[np.complex128], NDArray[np.uint8]]:
    """What the way to points [n, 3] and back leaves of an amplitude, 0 where they are hidden, and the kinds of path."""
    clear = clear_between(geometry, np.zeros((len(point), 3)), point)
    passed = clear.astype(np.complex128)
    kinds = np.full(len(point), SPECULAR, dtype=np.uint8)
    if settings.refraction and not clear.all():
        behind = np.flatnonzero(~clear)
        panes = panes_between(geometry, merged_scene, materials, frequency_hz, point[behind], settings.polarization[0])
        passed[behind] = np.where(np.abs(panes.factor) > FAINTEST, panes.factor, 0.0) ** 2
        kinds[behind] |= REFRACTED
    return passed, kinds


def plane_amplitude(
    merged_scene: MergedScene, materials: MaterialMapping, frequency_hz: float, mesh: NDArray[np.int64], range_m: Real
) -> NDArray[np.complex128]:
    """[n] amplitude of infinite planes of the meshes' materials, square to the sight at ``range_m`` [n]."""
    slabs, wavelength = slabs_of(merged_scene, materials), SPEED_OF_LIGHT / frequency_hz
    met, place = np.unique(mesh, return_inverse=True)
    reflection = np.array([_normal_reflection(slabs[index], frequency_hz) for index in met], dtype=complex)
    return np.conj(reflection)[place] * wavelength / (8.0 * np.pi * range_m)


def _perpendicular_feet(corners: Real, normals: Real) -> tuple[NDArray[np.int64], Real]:
    """Triangles [n] that hold the foot of the perpendicular from the origin, and the feet [n, 3] [m]."""
    height = np.einsum("ki,ki->k", normals, corners[:, 0])
    foot = height[:, None] * normals
    near = np.flatnonzero((np.abs(height) >= CLOSEST_M) & (foot[:, 0] >= -AHEAD_M))
    inside = np.ones(len(near), dtype=bool)
    for corner in range(3):
        a, b = corners[near, corner], corners[near, (corner + 1) % 3]
        turned = np.einsum("ki,ki->k", normals[near], np.cross(b - a, foot[near] - a))
        inside &= turned >= -INSIDE * np.einsum("ki,ki->k", b - a, b - a)
    found = near[inside]
    _, first = np.unique(np.rint(foot[found] / 1e-6), axis=0, return_index=True)
    chosen = found[np.sort(first)]
    return chosen, foot[chosen]


def _rates_of_normals(merged_scene: MergedScene, triangle: NDArray[np.int64], mesh: NDArray[np.int64]) -> Real:
    """[n, 3] rates [1/s] of the unit normals of triangles on meshes that turn, in the world.

    With N = a x b of two sides, N' = a' x b + a x b', and n' = (N' - n (n . N')) / |N|.
    """
    rates = np.zeros((len(triangle), 3))
    first = np.cumsum([0, *(len(item.triangles) for item in merged_scene.meshes)])
    for number in np.unique(mesh):
        item, here = merged_scene.meshes[number], np.flatnonzero(mesh == number)
        corners = item.triangles[triangle[here] - first[number]]
        assert item.turned is not None
        sides, changes = (
            values[corners][:, 1:] - values[corners][:, :1] for values in (item.vertices, item.turned.velocities)
        )
        area = np.cross(sides[:, 0], sides[:, 1])
        change = np.cross(changes[:, 0], sides[:, 1]) + np.cross(sides[:, 0], changes[:, 1])
        length = np.linalg.norm(area, axis=1, keepdims=True)
        normal = area / length
        rates[here] = (change - np.einsum("ki,ki->k", normal, change)[:, None] * normal) / length
    return rates


def _normal_reflection(material, frequency_hz: float) -> complex:
    one = np.ones(1)
    te, _ = slab_reflection(
        material.relative_permittivity, material.conductivity_s_per_m, material.thickness_m, frequency_hz, one
    )
    return complex(te[0]) * np.sqrt(1.0 - material.scattering_coefficient**2)
