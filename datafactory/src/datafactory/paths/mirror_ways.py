"""Ways over one mirror: from the radar by a smooth face to points, and back by reciprocity.

A face reflects a wave from the radar to a point p where the line from the radar to the image of p in the face's plane
meets the face. All such faces are found, whatever the number of rays. The field at p over that of free space at the
same length is

    g = conj(R e) sqrt(1 - S^2) F,

with R e what the slab reflects of the radar's unit field (TE and TM of ITU-R P.2040,
:func:`datafactory.paths.wave_steps.reflected_fields`), S the scattering coefficient and F the share of the face's size
(:mod:`datafactory.paths.facets`).

The loss of a rough surface is sqrt(1 - S^2), here as in every other path of the table; it does not depend on the angle.
Heights with a normal distribution of rms h leave exp(-2 (k h sin psi)^2) at the grazing angle psi (Ament, Toward a
theory of reflection by a rough surface, Proc. IRE 41, 1953). Of asphalt with h = 0.65 mm that is 0.0, -0.1, -0.6 and
-2.3 dB at 1, 5, 10 and 20 deg, where S has -0.4 dB. So the loss is right to 0.4 dB up to 10 deg of grazing, where road
users beyond 8 m stand for a radar at 0.5 m, and too small above.

Left out: ways over two mirrors, over curved ones and through panes; the light that the rough face scatters on to
the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.mirror_feet import CLOSEST_M, INSIDE, SAME_IMAGE_M
from datafactory.paths.panes import Polarization, polarization_axis
from datafactory.paths.slabs import LEAST_COSINE
from datafactory.paths.unfold import apart
from datafactory.paths.view import View
from datafactory.paths.wave_steps import reflected_fields
from shared.physics.compiled import compiled

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

TOUCHING_M = 1e-4
"""A point may lie this far behind a face and still stand on it: rounding of a scene's coordinates."""
AXES: tuple[Polarization, Polarization] = ("V", "H")
"""Components of a field across a direction: along theta^ and phi^."""


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
        above = np.einsum("wi,wi->w", self.normal, np.broadcast_to(place, self.normal.shape)) - self.height
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
    cosine = np.clip(np.abs(np.einsum("wi,wi->w", towards, normal)), LEAST_COSINE, 1.0)
    te, tm = view.slabs.reflection(mesh, cosine)
    sent, received = (
        np.conj(_field_at_point(towards, normal, te, tm, which)) * share[:, None]
        for which in view.settings.polarization
    )
    return _without_doubles(
        Ways(
            point=point,
            triangle=triangle,
            normal=normal,
            height=np.einsum("wi,wi->w", normal, view.corners[triangle, 0]),
            velocity=view.velocity(triangle, foot),
            sent=sent,
            received=received,
        ),
        position,
    )


def _clear(view: View, foot: Real, triangle: Index, position: Real) -> NDArray[np.bool_]:
    """[W] whether nothing stands on either leg.

    The point of reflection is lifted off its face, to the radar's side, by the error of rays in float32.
    """
    normal = view.normals[triangle]
    side = -np.sign(np.einsum("wi,wi->w", normal, view.corners[triangle, 0]))
    lifted = foot + (side * ray_margin_m(np.linalg.norm(foot, axis=1)))[:, None] * normal
    clear = view.sight(np.zeros_like(lifted), lifted)
    clear[clear] = view.sight(lifted[clear], position[clear])
    return clear


def _field_at_point(towards: Real, normal: Real, te: Complex, tm: Complex, polarization: Polarization) -> Complex:
    """[W, 2] components along theta^ and phi^ of what mirrors make of the radar's unit field."""
    field = polarization_axis(towards, polarization).astype(np.complex128)
    onward, reflected = reflected_fields(towards, normal, field, te, tm)
    return np.stack([np.einsum("wi,wi->w", reflected, polarization_axis(onward, axis)) for axis in AXES], axis=1)


def points_of_reflection(position: Real, corners: Real, normals: Real) -> tuple[Index, Index, Real]:
    """Where triangles reflect waves from the origin to points: numbers of point [W] and triangle [W], place [W, 3] [m].

    A face reflects on either side: radar and point are on the same one.

    :param position: [K, 3] [m]; :param corners: [T, 3, 3] [m]; :param normals: [T, 3] unit, 0 of a face without area
    """
    height = np.einsum("ti,ti->t", normals, corners[:, 0])
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(normals[:, None], edges)
    border = np.einsum("tci,tci->tc", inward, corners) - INSIDE * np.einsum("tci,tci->tc", edges, edges)
    found = _reflecting(np.ascontiguousarray(position), np.ascontiguousarray(normals), height, inward, border)
    point, triangle = np.array(found, dtype=np.int64).reshape(-1, 2).T
    normal, height = normals[triangle], height[triangle]
    above = np.einsum("wi,wi->w", normal, position[point]) - height
    image = position[point] - 2.0 * above[:, None] * normal
    radar = np.abs(height)
    share = radar / (radar + np.maximum(-np.sign(height) * above, 0.0))
    return point, triangle, share[:, None] * image


@compiled()
def _reflecting(position, normals, height, inward, border):
    """Pairs of point and triangle whose point of reflection lies within the triangle.

    :param inward: [T, 3, 3] normals of the edges, in the plane; :param border: [T, 3] the least n . x within
    """
    found = [(0, 0) for _ in range(0)]
    for k in range(len(position)):
        px, py, pz = position[k]
        for t in range(len(normals)):
            radar = abs(height[t])
            above = normals[t, 0] * px + normals[t, 1] * py + normals[t, 2] * pz - height[t]
            over = -above if height[t] > 0.0 else above  # positive on the radar's side
            if radar < CLOSEST_M or over < -TOUCHING_M:
                continue
            share = radar / (radar + max(over, 0.0))
            x = share * (px - 2.0 * above * normals[t, 0])
            y = share * (py - 2.0 * above * normals[t, 1])
            z = share * (pz - 2.0 * above * normals[t, 2])
            inside = True
            for c in range(3):
                if inward[t, c, 0] * x + inward[t, c, 1] * y + inward[t, c, 2] * z < border[t, c]:
                    inside = False
                    break
            if inside:
                found.append((k, t))
    return found


def _without_doubles(ways: Ways, position: Real) -> Ways:
    """One way for each mirror of a point: triangles that share an edge, and faces on top of each other, give one."""
    image = ways.image(position[ways.point])
    # Images of different points are as far apart as their numbers say.
    return ways.take(apart(np.column_stack([image, ways.point.astype(np.float64)]), SAME_IMAGE_M))
