"""Where flat triangles reflect: the one test of mirrors, which the rims beside them ask as well."""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real, dots

INSIDE = 1e-9
"""Barycentric coordinates may fall below zero by this: a foot on an edge belongs to both triangles, and counts once."""
TOUCHING_M = 1e-4
"""A point may lie this far behind a face and still stand on it: rounding of a scene's coordinates."""
NEAREST_M = 0.01
"""Nearer surfaces do not scatter, nearer mirrors are left out, as the solver does, and no pane counts as nearer: the
antennas' own size matters there."""


def points_of_reflection(position: Real, corners: Real, normals: Real) -> tuple[Index, Index, Real]:
    """Where triangles reflect waves from the origin to points: numbers of point [W] and triangle [W], place [W, 3] [m].

    A face reflects on either side: radar and point are on the same one.

    :param position: [K, 3] [m]; :param corners: [T, 3, 3] [m]; :param normals: [T, 3] unit, 0 of a face without area
    """
    height = dots(normals, corners[:, 0])
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(normals[:, None], edges)
    border = np.einsum("tci,tci->tc", inward, corners) - INSIDE * np.einsum("tci,tci->tc", edges, edges)
    found = _reflecting(np.ascontiguousarray(position), np.ascontiguousarray(normals), height, inward, border)
    point, triangle = np.array(found, dtype=np.int64).reshape(-1, 2).T
    normal, height = normals[triangle], height[triangle]
    above = dots(normal, position[point]) - height
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
            if radar < NEAREST_M or over < -TOUCHING_M:
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
