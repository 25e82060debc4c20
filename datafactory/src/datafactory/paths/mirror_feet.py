"""Single mirrors, found by the feet of their perpendiculars: all of them, whatever the number of rays.

A facet gives a single specular echo where it contains the foot of the perpendicular from the radar. The solver finds
that echo only if a ray hits the facet, so that a small facet appears in some realisations and not in others. This
module computes the foot on every triangle in the front half space, into which the rays are sent. The amplitude is

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) F,

with Gamma the slab's reflection coefficient at normal incidence (ITU-R P.2040-3, eq. (37)), S the scattering
coefficient, and F the factor of the facet's size (:mod:`datafactory.paths.facets`). The echo has no cross-polarised
part.

Triangles that sample a curved surface have no feet here; the surface has (:mod:`datafactory.paths.curved_echoes`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.facets import COPLANAR_M
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.panes import FAINTEST, panes_between
from datafactory.paths.table import REFRACTED, SPECULAR, SpecularPaths
from datafactory.paths.unfold import apart
from datafactory.paths.view import View

Real = NDArray[np.float64]

INSIDE = 1e-9
"""Barycentric coordinates may fall below zero by this: a foot on an edge belongs to both triangles, and counts once."""
CLOSEST_M = 0.01
"""Nearer mirrors are left out, as the solver does: the antennas' own size matters there."""
SAME_IMAGE_M = 2.0 * COPLANAR_M
"""Images nearer to each other belong to one mirror: faces that lie in one plane, or on top of each other."""
AHEAD_M = 1e-6
"""A foot straight below the radar lies at x = 0, apart from rounding, and counts as ahead."""


def single_mirrors(view: View) -> tuple[SpecularPaths, dict[str, int]]:
    """All single specular echoes of a frame, and how many are hidden."""
    merged, polarization = view.merged, view.settings.polarization
    if not merged.meshes or polarization[0] != polarization[1]:
        return SpecularPaths.none(), {}
    found, foot = _perpendicular_feet(view.corners[view.flat], view.normals[view.flat])
    triangle = view.flat[found]
    passed, kinds = way_and_back(view, foot)
    seen = np.flatnonzero(passed != 0.0)
    every, seen = _without_doubles(foot, np.arange(len(foot))), _without_doubles(foot, seen)
    hidden = len(every) - len(seen)
    triangle, foot, passed, kinds = triangle[seen], foot[seen], passed[seen], kinds[seen]
    range_m, mesh = np.linalg.norm(foot, axis=1), merged.mesh_of_triangle[triangle]
    direction, normal = foot / range_m[:, None], view.normals[triangle]
    amplitude = plane_amplitude(view, mesh, range_m) * passed
    if view.settings.finite_mirrors:
        off = np.einsum("ki,ki->k", foot, normal) - view.heights[triangle]
        amplitude *= view.reflected_share(triangle, foot - off[:, None] * normal, foot, range_m, range_m)
    approach = np.einsum("ki,ki->k", direction, view.velocity(triangle, foot))
    image_velocity = 2.0 * approach[:, None] * direction
    turned = np.flatnonzero(np.array([item.turned is not None for item in merged.meshes])[mesh])
    turning = _rates_of_normals(merged, triangle[turned], mesh[turned]) @ view.rotation
    side = np.sign(np.einsum("ki,ki->k", normal[turned], direction[turned]))
    image_velocity[turned] += 2.0 * (side * range_m[turned])[:, None] * turning
    axes = np.eye(3) - 2.0 * direction[:, :, None] * direction[:, None, :]
    paths = SpecularPaths.of(2.0 * foot, image_velocity, axes, amplitude, view.owner[triangle], kinds)
    return paths, {"mirrors_hidden": hidden}


def _without_doubles(foot: Real, index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the feet ``index`` that belong to different mirrors, rising; of faces on top of each other the nearest.

    Triangles that share an edge may both hold a foot on it.
    """
    nearest = index[np.argsort(np.rint(np.linalg.norm(foot[index], axis=1) / 1e-6), kind="stable")]
    return np.sort(nearest[apart(2.0 * foot[nearest], SAME_IMAGE_M)])


def way_and_back(view: View, point: Real) -> tuple[NDArray[np.complex128], NDArray[np.uint8]]:
    """What the way to points [n, 3] and back leaves of an amplitude, 0 where they are hidden, and the kinds of path."""
    clear = view.sight(np.zeros((len(point), 3)), point)
    passed = clear.astype(np.complex128)
    kinds = np.full(len(point), SPECULAR, dtype=np.uint8)
    if view.settings.refraction and not clear.all():
        behind = np.flatnonzero(~clear)
        panes = panes_between(view, point[behind], view.settings.polarization[0])
        passed[behind] = np.where(np.abs(panes.factor) > FAINTEST, panes.factor, 0.0) ** 2
        kinds[behind] |= REFRACTED
    return passed, kinds


def plane_amplitude(view: View, mesh: NDArray[np.int64], range_m: Real) -> NDArray[np.complex128]:
    """[n] amplitude of infinite planes of the meshes' materials, square to the sight at ``range_m`` [n]."""
    te, _ = view.slabs.reflection(mesh, np.ones(len(mesh)))
    scale = view.wavelength_m / (8.0 * np.pi * range_m)
    return np.asarray(np.conj(te) * (view.slabs.unscattered(mesh) * scale), dtype=np.complex128)


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
    return near[inside], foot[near[inside]]


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
