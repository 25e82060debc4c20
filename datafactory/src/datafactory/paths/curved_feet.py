"""Single mirrors on curved surfaces: the points at which a surface's normal goes through the radar, its feet.

Over a triangle of corners p_i and normals n_i the normal is sum b_i n_i, with b the barycentric coordinates. A foot is
where it is parallel to the way from the radar, sum b_i p_i. The point on the surface lies over that point of the chord,
along the normal, by the height of the arc

    sum b_i n_i . (p_i - x) / (1 + |sum b_i n_i|),

exact on spheres and cylinders. What is sent back from there: :mod:`datafactory.paths.curved_echoes`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns
from datafactory.paths.curved_surfaces import CurvedSurfaces, turned_to
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.unfold import apart, unit

Real = NDArray[np.float64]
Index = NDArray[np.int64]

INSIDE = 1e-6
"""Barycentric coordinates may fall below zero by this: triangles share their sides, and a foot there is one."""
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


def curved_feet(surfaces: CurvedSurfaces, moved: Real, rotation: Real, ahead_m: float) -> tuple[CurvedFeet, int]:
    """All feet that lie ahead, and the number of triangles left out because they lie around their own focus.

    :param moved: [C, 3] what brings each triangle from its place at time 0 to the radar's origin, world [m]
    :param rotation: [3, 3] of the radar in the world
    :param ahead_m: feet of smaller x [m] are behind
    """
    corners, normals = (surfaces.corners + moved[:, None]) @ rotation, surfaces.normals @ rotation
    weight, focused = _barycentric_feet(corners, normals)
    size = np.sqrt(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1))
    point, mean = (np.einsum("ci,cij->cj", weight, part) for part in (corners, normals))
    kept = np.flatnonzero((weight >= -INSIDE).all(axis=1) & (point[:, 0] >= ahead_m))
    kept = kept[apart(point[kept], SAME_FOOT * size[kept])]
    weight, point, corners, at_corners = weight[kept], point[kept], corners[kept], normals[kept]
    length = np.linalg.norm(mean[kept], axis=1)
    normal = mean[kept] / length[:, None]
    # The height of the arc over the chord: exact on spheres and cylinders, whose |n| is the chord's distance over r.
    height = np.einsum("ni,nij,nij->n", weight, corners - point[:, None], at_corners) / (1.0 + length)
    foot = point + height[:, None] * normal
    nearer = np.linalg.norm(foot, axis=1) < np.linalg.norm(point, axis=1)
    curvature, axes = _principal(surfaces.tensors[kept], weight, at_corners, normal, rotation)
    aside = (
        BESIDE
        * ray_margin_m(np.linalg.norm(foot, axis=1))[:, None]
        * (np.cos(1.0) * axes[:, 0] + np.sin(1.0) * axes[:, 1])
    )
    away = np.einsum("ni,ni->n", normal, foot) > 0.0
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
    height = np.einsum("ci,ci->c", corners[:, 0], facing)
    e_t, d_t = np.einsum("cki,cji->ckj", frame, e), np.einsum("cki,cji->ckj", frame, d)
    p_t, n_t = np.einsum("cki,ci->ck", frame, corners[:, 0]), np.einsum("cki,ci->ck", frame, normals[:, 0])
    n_f, d_f = np.einsum("ci,ci->c", normals[:, 0], facing), np.einsum("cji,ci->cj", d, facing)
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
