"""Single mirrors on curved surfaces: where their echoes come from, how strong they are, when they arrive.

docs/notes/curved.md has the method, how exact it is, and its limits. With R the distance of the foot, at which the
normal goes through the radar, and kappa_1, kappa_2 the principal curvatures there (positive where convex towards the
radar; Kouyoumjian and Pathak, Proc. IEEE 62, 1974, p. 1448; Balanis, Advanced Engineering Electromagnetics, section
13.2),

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) G F,   G = 1 / sqrt((1 + kappa_1 R) (1 + kappa_2 R)),

with Gamma and S as for a plane (:mod:`datafactory.paths.mirrors`). F is the share of a surface that ends near the foot:
the Fresnel integral of :mod:`datafactory.paths.facets`, along the principal directions, with 1 / R + kappa_i in place
of 1 / R, over what lies within those rims that face the radar. The incidence is normal: no cross-polarised part.

A factor 1 + kappa_i R below 0 means a focus on the way: its root is taken of the magnitude, and the phase is a quarter
of a cycle less. Near a focus the magnitude is kept above lambda kappa_i^2 R / 2, at which a mirror as wide as its
radius of curvature covers one Fresnel zone.

Delay law. To second order in the positions a, b of TX and RX across the sight u, with W the curvature tensor,

    c tau = 2 R - u . (a + b) + |a - b|^2 / (4 R) + (a + b) . K (a + b) / 4,   K = W (1 + R W)^-1.

As the surface moves with V, u turns with K V; where its normal turns as well, at a rate w, with K V + (1 + R W)^-1 w.
With k the value of K along the array's axis y, scattered paths with S = 2 R / (1 + R k), q = S u, p = (2 / k - S) u and
b = 2 R - 2 / k are exact to second order for a TX at the origin, in time too, and else off by

    |a| |b| |1 / R - k| / 2 + |a|^2 |1 / S - 1 / |p|| / 2.

Specular paths with image 2 R u, as of the tangent plane, are off by |a + b|^2 |k| / 4. The law with the smaller error
for ``TX_OFFSET_M`` and ``RX_OFFSET_M`` is used.

Limits: k r > 50 (no creeping waves, no tips); within some Fresnel zones the surface is of one material and its
curvature is constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns, apart
from datafactory.paths.curved_surfaces import CurvedSurfaces, curved_surfaces_of, turned_to
from datafactory.paths.facets import share_within_rims
from datafactory.paths.feet import NEAREST_M
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.mirrors import AHEAD_M, MirrorEchoes, plane_amplitude, rates_of_normals, way_and_back
from datafactory.paths.table import ScatteredPaths, SpecularPaths
from datafactory.paths.view import View
from shared.physics.vectors import Complex, Index, Mask, Real, dots, unit

INSIDE = 1e-6
"""Barycentric coordinates may fall below zero by this: triangles share their sides, and a foot there is one."""
BEHIND_M = 1e-3
"""A triangle so far behind the sensor has no foot ahead of it, nor beside itself by :data:`INSIDE`."""
SAME_FOOT = 1e-4
"""Feet nearer than this share of the triangle's size are one."""
ROUNDS = 5
"""Of the search for the foot in a triangle; the first is exact on a plane, the second on spheres and cylinders."""
BESIDE = 3.0
"""The line of sight ends so many of the ray caster's errors beside the foot, in no direction of note: lines that run
exactly through edges of a mesh, as in symmetric scenes, slip through it."""
FLATTEST = 1e-9
"""Determinant of the search's equations over that of a plane, below which all points of a triangle are feet: it lies
around its focus."""
TX_OFFSET_M, RX_OFFSET_M = 0.05, 0.25
"""Distances from the origin of the default radar's TX, and of the outermost RX of the truth's sensor [m]."""
ALONG_AXIS = 1e-6
"""Square of the sine of the angle between sight and array, below which the array has no length across the sight."""


@dataclass(frozen=True)
class CurvedFeet(Columns):
    """n points of curved surfaces whose normals go through the radar, in the radar frame.

    :param triangle: [n] index among all triangles of the merged scene; :param surface: [n]
    :param foot: [n, 3] on the surface [m]
    :param seen_to: [n, 3] just beside the foot, or the facet's point before it [m]: what hides the foot is nearer still
    :param normal: [n, 3] unit, on the surface's side
    :param curvature: [n, 2] principal curvatures, positive where convex towards the radar [1/m]
    :param axes: [n, 2, 3] their directions, unit
    """

    triangle: Index
    surface: Index
    foot: Real
    seen_to: Real
    normal: Real
    curvature: Real
    axes: Real

    def range_m(self) -> Real:
        """[n] distances from the radar [m]."""
        return np.linalg.norm(self.foot, axis=1)


def curved_feet(surfaces: CurvedSurfaces, view: View) -> tuple[CurvedFeet, int]:
    """All feet that lie ahead, and how many of the triangles ahead are left out because they lie around their focus.

    Over a triangle of corners p_i and normals n_i the normal is sum b_i n_i, with b the barycentric coordinates. A foot
    is where it is parallel to the way from the radar, sum b_i p_i. The surface lies over that point of the chord, along
    the normal, by the height of the arc sum b_i n_i . (p_i - x) / (1 + |sum b_i n_i|), exact on spheres and cylinders.
    """
    moved, rotation = view.moved[view.merged.mesh_of_triangle[surfaces.triangle]], view.rotation
    corners = (surfaces.corners + moved[:, None]) @ rotation
    ahead = np.flatnonzero(corners[:, :, 0].max(axis=1) >= -BEHIND_M)
    corners, normals = corners[ahead], surfaces.normals[ahead] @ rotation
    weight, focused = _barycentric_feet(corners, normals)
    size = np.sqrt(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
    point, mean = (np.einsum("ci,cij->cj", weight, part) for part in (corners, normals))
    kept = np.flatnonzero((weight >= -INSIDE).all(axis=1) & (point[:, 0] >= -AHEAD_M))
    kept = kept[apart(point[kept], SAME_FOOT * size[kept])]
    weight, point, corners, at_corners = weight[kept], point[kept], corners[kept], normals[kept]
    mean, kept = mean[kept], ahead[kept]
    length = np.linalg.norm(mean, axis=1)
    normal = mean / length[:, None]
    height = np.einsum("ni,nij,nij->n", weight, corners - point[:, None], at_corners) / (1.0 + length)
    foot = point + height[:, None] * normal
    nearer = np.linalg.norm(foot, axis=1) < np.linalg.norm(point, axis=1)
    curvature, axes = _principal(surfaces.tensors[kept], weight, at_corners, normal, rotation)
    aside = (
        BESIDE
        * ray_margin_m(np.linalg.norm(foot, axis=1))[:, None]
        * (np.cos(1.0) * axes[:, 0] + np.sin(1.0) * axes[:, 1])
    )
    away = dots(normal, foot) > 0.0
    return CurvedFeet(
        triangle=surfaces.triangle[kept],
        surface=surfaces.surface[kept],
        foot=foot,
        seen_to=np.where(nearer[:, None], foot, point) + aside,
        normal=normal,
        curvature=np.where(away[:, None], -curvature, curvature),
        axes=axes,
    ), focused


def _barycentric_feet(corners: Real, normals: Real) -> tuple[Real, int]:
    """[C, 3] weights b with sum b_i n_i parallel to sum b_i p_i, outside 0..1 where a triangle has no foot.

    With f the facet's normal, h its distance from the origin and t across f, x . t (n . f) = h n . t; solved with n . f
    of the round before. Last, the number of triangles without a solution.
    """
    e = corners[:, 1:] - corners[:, :1]
    d = normals[:, 1:] - normals[:, :1]
    area = np.cross(e[:, 0], e[:, 1])
    facing = unit(area)
    t1 = unit(e[:, 0])
    frame = np.stack([t1, np.cross(facing, t1)], axis=1)
    height = dots(corners[:, 0], facing)
    e_t, d_t = np.einsum("cki,cji->ckj", frame, e), np.einsum("cki,cji->ckj", frame, d)
    p_t, n_t = np.einsum("cki,ci->ck", frame, corners[:, 0]), np.einsum("cki,ci->ck", frame, normals[:, 0])
    n_f, d_f = dots(normals[:, 0], facing), np.einsum("cji,ci->cj", d, facing)
    b = np.full((len(corners), 2), 1.0 / 3.0)
    least = FLATTEST * np.linalg.norm(area, axis=1)
    focused = np.zeros(len(corners), dtype=bool)
    for _ in range(ROUNDS):
        c = n_f + np.einsum("cj,cj->c", d_f, b)
        matrix = c[:, None, None] * e_t - height[:, None, None] * d_t
        right = height[:, None] * n_t - c[:, None] * p_t
        determinant = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
        focused |= np.abs(determinant) <= least
        divisor = np.where(focused, 1.0, determinant)
        b = np.stack(
            [
                (right[:, 0] * matrix[:, 1, 1] - right[:, 1] * matrix[:, 0, 1]) / divisor,
                (right[:, 1] * matrix[:, 0, 0] - right[:, 0] * matrix[:, 1, 0]) / divisor,
            ],
            axis=1,
        )
        b = np.clip(b, -1.0, 2.0)  # far outside, the mean normal means nothing
        b[focused] = -1.0
    return np.concatenate([1.0 - b.sum(axis=1, keepdims=True), b], axis=1), int(focused.sum())


def _principal(tensors: Real, weight: Real, at_corners: Real, normal: Real, rotation: Real) -> tuple[Real, Real]:
    """Principal curvatures [n, 2] and directions [n, 2, 3], in the radar frame, of tensors in the world's."""
    turned = np.swapaxes(rotation[None], 1, 2) @ tensors.reshape(-1, 3, 3) @ rotation
    turned = turned_to(turned, at_corners.reshape(-1, 3), np.repeat(normal, 3, axis=0)).reshape(-1, 3, 3, 3)
    tensor = np.einsum("ni,nijk->njk", weight, turned)
    t1 = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)]))
    frame = np.stack([t1, np.cross(normal, t1)], axis=1)
    curvature, local = np.linalg.eigh(frame @ tensor @ np.swapaxes(frame, 1, 2))
    return curvature, np.swapaxes(local, 1, 2) @ frame


def focus_factors(feet: CurvedFeet, wavelength_m: float) -> Real:
    """[n, 2] 1 + kappa_i R, kept off 0."""
    range_m = feet.range_m()[:, None]
    factor = 1.0 + feet.curvature * range_m
    least = 0.5 * wavelength_m * feet.curvature**2 * range_m
    return np.where(feet.curvature < 0.0, np.where(factor < 0.0, -1.0, 1.0) * np.maximum(np.abs(factor), least), factor)


def curved_shares(surfaces: CurvedSurfaces, feet: CurvedFeet, view: View) -> Complex:
    """[n] G F: the amplitude over that of an infinite plane at the same distance."""
    wavelength_m, rotation = view.wavelength_m, view.rotation
    factor = focus_factors(feet, wavelength_m)
    divergence = np.prod(np.abs(factor), axis=1) ** -0.5 * (-1.0j) ** (factor < 0.0).sum(axis=1)
    if not view.settings.finite_mirrors:
        return divergence
    range_m = feet.range_m()
    scale = np.sqrt(2.0 * np.abs(factor) / (range_m[:, None] * wavelength_m))
    moved, share = view.moved[view.merged.mesh_of_triangle[feet.triangle]], np.ones(len(feet), dtype=np.complex128)
    normals = surfaces.rim_normals @ rotation
    for index in range(len(feet)):
        here = surfaces.rim_surface == feet.surface[index]
        rims = (surfaces.rims[here] + moved[index]) @ rotation
        side = dots(normals[here], rims.mean(axis=1))
        rims = rims[side * (feet.normal[index] @ feet.foot[index]) > 0.0]
        if len(rims):
            along = feet.axes[index, 0]
            across = np.cross(feet.normal[index], along)
            share[index] = share_within_rims(
                np.ascontiguousarray(rims), feet.foot[index], along * scale[index, 0], across * scale[index, 1]
            )
    return divergence * np.where((factor < 0.0).all(axis=1), np.conj(share), share)


def _paths(
    feet: CurvedFeet, amplitude: Complex, kinds: NDArray[np.uint8], view: View
) -> tuple[ScatteredPaths, SpecularPaths]:
    """The echoes with the delay law that suits each."""
    range_m, velocity = feet.range_m(), view.velocity(feet.triangle, feet.foot)
    sight = feet.foot / range_m[:, None]
    bend = feet.curvature / focus_factors(feet, view.wavelength_m)
    rate = dots(sight, velocity)
    mesh = view.merged.mesh_of_triangle[feet.triangle]
    turned = rates_of_normals(view.merged, feet.triangle, mesh) @ view.rotation
    turned *= np.sign(dots(view.normals[feet.triangle], sight))[:, None]
    moved, turned = (np.einsum("nji,ni->nj", feet.axes, vector) for vector in (velocity, turned))
    changes = bend * moved + turned / focus_factors(feet, view.wavelength_m)
    turning = np.einsum("nj,nji->ni", changes, feet.axes)
    k = _along_array(sight, bend, feet.axes)
    laws = _law_of_points(range_m, k)
    echoes = MirrorEchoes(sight, range_m, rate, turning, amplitude, view.merged.owner[feet.triangle], kinds)
    return _scattered(echoes.take(laws), k[laws]), echoes.take(~laws).images()


def _along_array(sight: Real, bend: Real, axes: Real) -> Real:
    """[n] k, the value along the array of K with principal values ``bend`` [n, 2]; their mean for an array end on."""
    across = np.array([0.0, 1.0, 0.0]) - sight[:, 1:2] * sight
    square = dots(across, across)
    part = np.einsum("nji,ni->nj", axes, across) ** 2
    known = square > ALONG_AXIS
    return np.where(known, np.einsum("nj,nj->n", bend, part) / np.where(known, square, 1.0), 0.5 * bend.sum(axis=1))


def _law_of_points(range_m: Real, k: Real) -> Mask:
    """[n] whether the law of scattered paths has the smaller error; that of specular ones holds for every k."""
    positive = np.where(k > 0.0, k, 1.0)
    sum_m = 2.0 * range_m / (1.0 + range_m * positive)
    point = TX_OFFSET_M * RX_OFFSET_M * np.abs(1.0 / range_m - positive) / 2.0
    point += TX_OFFSET_M**2 * np.abs(1.0 / sum_m - 1.0 / (2.0 / positive - sum_m)) / 2.0
    image = (TX_OFFSET_M + RX_OFFSET_M) ** 2 * np.abs(k) / 4.0
    return (k > 0.0) & (point < image)


def _scattered(echoes: MirrorEchoes, k: Real) -> ScatteredPaths:
    sight, range_m, rate, turning = echoes.sight, echoes.range_m, echoes.rate, echoes.turning
    rx_m = 2.0 * range_m / (1.0 + range_m * k)
    tx_m = 2.0 / k - rx_m
    rx_rate = 0.5 * rx_m**2 * (1.0 / range_m**2 + k**2) * rate
    return ScatteredPaths(
        tx_point=tx_m[:, None] * sight,
        rx_point=rx_m[:, None] * sight,
        tx_velocity=(2.0 * rate - rx_rate)[:, None] * sight + tx_m[:, None] * turning,
        rx_velocity=rx_rate[:, None] * sight + rx_m[:, None] * turning,
        between_m=2.0 * range_m - 2.0 / k,
        between_rate_mps=np.zeros(len(k)),
        amplitude=echoes.amplitude,
        depth=np.ones(len(k), dtype=np.int8),
        object_index=echoes.owner,
        kinds=echoes.kinds,
    )


def curved_mirrors(view: View) -> tuple[ScatteredPaths, SpecularPaths, dict[str, int]]:
    """All single echoes of curved surfaces in a frame, by the delay law that suits each, and counts.

    :return: counts are ``curved_mirrors``, ``curved_mirrors_hidden``, ``triangles_round_their_focus`` of scenes that
        have a curved surface, and ``facets_too_coarse`` of those whose facets may stand for one
    """
    surfaces, settings = curved_surfaces_of(view.merged), view.settings
    counts = {"facets_too_coarse": surfaces.coarse} if surfaces.coarse else dict[str, int]()
    if not len(surfaces) or settings.polarization[0] != settings.polarization[1]:
        return ScatteredPaths.none(), SpecularPaths.none(), counts
    every, focused = curved_feet(surfaces, view)
    every = every.take(every.range_m() >= NEAREST_M)
    passed, kinds = way_and_back(view, every.seen_to)
    seen = np.flatnonzero(passed != 0.0)
    feet = every.take(seen)
    whole = plane_amplitude(view, view.merged.mesh_of_triangle[feet.triangle], feet.range_m())
    points, images = _paths(feet, whole * (curved_shares(surfaces, feet, view) * passed[seen]), kinds[seen], view)
    counts |= {
        "curved_mirrors": len(feet),
        "curved_mirrors_hidden": len(every) - len(feet),
        "triangles_round_their_focus": focused,
    }
    return points, images, counts
