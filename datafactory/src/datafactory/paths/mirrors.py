"""Flat mirrors: all of them, whatever the number of rays; the radar's own echo of each, and ways over one to points.

**Single mirrors.** A facet gives a single specular echo where it contains the foot of the perpendicular from the radar.
The solver finds that echo only if a ray hits the facet. The amplitude at the distance R is

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) F,

with Gamma the slab's reflection coefficient at normal incidence (:mod:`datafactory.paths.slabs`), S the scattering
coefficient, and F the factor of the facet's size (:mod:`datafactory.paths.facets`). The echo has no cross-polarised
part. Mirrors in the front half space count, into which rays are sent.

**Ways to points** (docs/notes/targets.md). A face reflects a wave from the radar to a point p where the line from the
radar to the image of p in the face's plane meets the face. The way back is that out, by reciprocity. The field at p
over that of free space at the same length is

    g = conj(R e) sqrt(1 - S^2) F,

with R e what the slab reflects of the radar's unit field (:func:`datafactory.paths.slabs.fields_beyond`).

Limits: the loss of a rough surface, sqrt(1 - S^2), does not depend on the angle; of asphalt it is right to 0.4 dB up to
10 deg of grazing (Ament 1953), and too small above. Left out: ways over two mirrors, over curved ones and through
panes; the light that the rough face scatters on to the point. Triangles that sample a curved surface have no feet here;
the surface has (:mod:`.curved_echoes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns, apart
from datafactory.paths.facets import COPLANAR_M
from datafactory.paths.feet import TOUCHING_M, points_of_reflection
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.slabs import LEAST_COSINE, fields_beyond
from datafactory.paths.table import REFRACTED, SPECULAR, SpecularPaths
from datafactory.paths.view import AXES, FAINTEST, Polarization, View, panes_between, polarization_axis
from shared.physics.vectors import Complex, Index, Mask, Real, dots

SAME_IMAGE_M = 2.0 * COPLANAR_M
"""Images nearer to each other belong to one mirror: faces that lie in one plane, or on top of each other."""
AHEAD_M = 1e-6
"""A foot straight below the radar lies at x = 0, apart from rounding, and counts as ahead."""


@dataclass(frozen=True)
class MirrorEchoes(Columns):
    """n echoes of single mirrors, flat or curved, at whose feet the sight is the normal.

    :param sight: [n, 3] unit vectors to the feet; :param range_m: [n] R; :param rate: [n] of R [m/s]
    :param turning: [n, 3] rate of the sight's direction at which the mirror is met [1/s]
    :param amplitude, owner, kinds: [n] fields of the path table
    """

    sight: Real
    range_m: Real
    rate: Real
    turning: Real
    amplitude: Complex
    owner: NDArray[np.int32]
    kinds: NDArray[np.uint8]

    def images(self) -> SpecularPaths:
        """With the delay law of the tangent planes, in which the radar has its image at 2 R."""
        sight, range_m = self.sight, self.range_m[:, None]
        velocity = 2.0 * self.rate[:, None] * sight + 2.0 * range_m * self.turning
        axes = np.eye(3) - 2.0 * sight[:, :, None] * sight[:, None, :]
        return SpecularPaths.of(2.0 * range_m * sight, velocity, axes, self.amplitude, self.owner, self.kinds)


def single_mirrors(view: View) -> tuple[SpecularPaths, dict[str, int]]:
    """All single specular echoes of a frame, and how many are hidden."""
    merged, polarization = view.merged, view.settings.polarization
    if not merged.meshes or polarization[0] != polarization[1]:
        return SpecularPaths.none(), {}
    triangle, foot = view.feet
    ahead = foot[:, 0] >= -AHEAD_M
    triangle, foot = triangle[ahead], foot[ahead]
    passed, kinds = way_and_back(view, foot)
    seen = np.flatnonzero(passed != 0.0)
    every, seen = _nearest_of_doubles(foot, np.arange(len(foot))), _nearest_of_doubles(foot, seen)
    hidden = len(every) - len(seen)
    triangle, foot, passed, kinds = triangle[seen], foot[seen], passed[seen], kinds[seen]
    range_m, mesh = np.linalg.norm(foot, axis=1), merged.mesh_of_triangle[triangle]
    sight, normal = foot / range_m[:, None], view.normals[triangle]
    amplitude = plane_amplitude(view, mesh, range_m) * passed
    if view.settings.finite_mirrors:
        off = dots(foot, normal) - view.heights[triangle]
        amplitude *= view.reflected_share(triangle, foot - off[:, None] * normal, foot, range_m, range_m)
    rate = dots(sight, view.velocity(triangle, foot))
    side = np.sign(dots(normal, sight))
    turning = side[:, None] * rates_of_normals(merged, triangle, mesh) @ view.rotation
    echoes = MirrorEchoes(sight, range_m, rate, turning, amplitude, merged.owner[triangle], kinds)
    return echoes.images(), {"mirrors_hidden": hidden}


def _nearest_of_doubles(foot: Real, index: Index) -> Index:
    """Those of the feet ``index`` that belong to different mirrors, rising; of faces on top of each other the nearest.

    Triangles that share an edge may both hold a foot on it.
    """
    nearest = index[np.argsort(np.rint(np.linalg.norm(foot[index], axis=1) / 1e-6), kind="stable")]
    return np.sort(nearest[apart(2.0 * foot[nearest], SAME_IMAGE_M)])


def way_and_back(view: View, point: Real) -> tuple[Complex, NDArray[np.uint8]]:
    """What the way to points [n, 3] and back leaves of an amplitude, 0 where they are hidden, and the kinds of path."""
    clear = view.sight(np.zeros((len(point), 3)), point)
    passed = clear.astype(np.complex128)
    kinds = np.full(len(point), SPECULAR, dtype=np.uint8)
    if view.settings.refraction and not clear.all():
        behind = np.flatnonzero(~clear)
        panes = panes_between(view, point[behind], view.settings.polarization[0])
        passed[behind] = np.where(np.abs(panes) > FAINTEST, panes, 0.0) ** 2
        kinds[behind] |= REFRACTED
    return passed, kinds


def plane_amplitude(view: View, mesh: Index, range_m: Real) -> Complex:
    """[n] amplitude of infinite planes of the meshes' materials, square to the sight at ``range_m`` [n]."""
    te, _ = view.slabs.reflection(mesh, np.ones(len(mesh)))
    scale = view.wavelength_m / (8.0 * np.pi * range_m)
    return np.asarray(np.conj(te) * (view.slabs.unscattered(mesh) * scale), dtype=np.complex128)


def rates_of_normals(merged_scene: MergedScene, triangle: Index, mesh: Index) -> Real:
    """[n, 3] rates [1/s] of the unit normals of triangles, in the world: 0 but on meshes that turn.

    With N = a x b of two sides, N' = a' x b + a x b', and n' = (N' - n (n . N')) / |N|.
    """
    rates, turned = np.zeros((len(triangle), 3)), merged_scene.turned[mesh]
    if not turned.any():
        return rates
    of_all = (merged_scene.corners, merged_scene.corner_velocities)
    sides, changes = (values[triangle[turned], 1:] - values[triangle[turned], :1] for values in of_all)
    area = np.cross(sides[:, 0], sides[:, 1])
    change = np.cross(changes[:, 0], sides[:, 1]) + np.cross(sides[:, 0], changes[:, 1])
    length = np.linalg.norm(area, axis=1, keepdims=True)
    normal = area / length
    rates[turned] = (change - dots(normal, change)[:, None] * normal) / length
    return rates


@dataclass(frozen=True)
class Ways(Columns):
    """W ways from the radar over one mirror each to points, in the radar frame.

    :param point: [W] number of the point
    :param triangle: [W] that reflects, index into the merged scene's triangles
    :param normal: [W, 3] unit, of its plane; :param height: [W] n . x of the plane [m]
    :param velocity: [W, 3] of the mirror relative to the radar [m/s]
    :param sent: [W, 2] field at the point over that of free space, along theta^ and phi^, in the table's convention
    :param received: [W, 2] the same for the RX's polarisation, by reciprocity
    """

    point: Index
    triangle: Index
    normal: Real
    height: Real
    velocity: Real
    sent: Complex
    received: Complex

    def image(self, place: Real) -> Real:
        """[W, 3] mirror images of places [3] or [W, 3] [m]."""
        above = dots(self.normal, np.broadcast_to(place, self.normal.shape)) - self.height
        return place - 2.0 * above[:, None] * self.normal


def ways_over_mirrors(view: View, position: Real) -> Ways:
    """All clear ways from the radar over one mirror to points, by point and triangle.

    :param position: [K, 3] in the radar frame [m]
    """
    point, found, foot = points_of_reflection(position, view.corners[view.flat], view.normals[view.flat])
    triangle = view.flat[found]
    clear = _clear(view, foot, triangle, position[point])
    point, triangle, foot = point[clear], triangle[clear], foot[clear]
    normal, before, mesh = view.normals[triangle], np.linalg.norm(foot, axis=1), view.merged.mesh_of_triangle[triangle]
    towards = foot / before[:, None]
    share = view.slabs.unscattered(mesh).astype(np.complex128)
    if view.settings.finite_mirrors and len(point):
        after = np.maximum(np.linalg.norm(position[point] - foot, axis=1), TOUCHING_M)
        share *= view.reflected_share(triangle, foot, foot, before, after)
    cosine = np.clip(np.abs(dots(towards, normal)), LEAST_COSINE, 1.0)
    te, tm = view.slabs.reflection(mesh, cosine)
    sent, received = (
        np.conj(_field_at_point(towards, normal, te, tm, which)) * share[:, None]
        for which in view.settings.polarization
    )
    ways = Ways(
        point=point,
        triangle=triangle,
        normal=normal,
        height=dots(normal, view.corners[triangle, 0]),
        velocity=view.velocity(triangle, foot),
        sent=sent,
        received=received,
    )
    # Of faces on top of each other one counts. Images of different points are as far apart as their numbers say.
    images = np.column_stack([ways.image(position[point]), point.astype(np.float64)])
    return ways.take(apart(images, SAME_IMAGE_M))


def _clear(view: View, foot: Real, triangle: Index, position: Real) -> Mask:
    """[W] whether nothing stands on either leg.

    The point of reflection is lifted off its face, to the radar's side, by the error of rays in float32.
    """
    normal = view.normals[triangle]
    side = -np.sign(dots(normal, view.corners[triangle, 0]))
    lifted = foot + (side * ray_margin_m(np.linalg.norm(foot, axis=1)))[:, None] * normal
    clear = view.sight(np.zeros_like(lifted), lifted)
    clear[clear] = view.sight(lifted[clear], position[clear])
    return clear


def _field_at_point(towards: Real, normal: Real, te: Complex, tm: Complex, polarization: Polarization) -> Complex:
    """[W, 2] components along theta^ and phi^ of what mirrors make of the radar's unit field."""
    field = polarization_axis(towards, polarization).astype(np.complex128)
    onward, reflected = fields_beyond(towards, normal, field, te, tm, True)
    return np.stack([np.einsum("wi,wi->w", reflected, polarization_axis(onward, axis)) for axis in AXES], axis=1)
