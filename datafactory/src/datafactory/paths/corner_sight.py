"""Which pieces of the apertures of right-angled corners are in sight: both legs to points of both faces are free.

The aperture of either order is looked at within the first Fresnel zones (:class:`.corner_aperture.FaceOrder`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.corner_aperture import ACROSS, Cells, FaceOrder, Views
from datafactory.paths.corner_edges import CornerEdges
from datafactory.paths.diffraction import Sight
from datafactory.paths.ray_hits import ray_margin_m
from shared.physics.compiled import compiled


def pieces_in_sight(
    corners: CornerEdges, cells: Cells, views: Views, wavelength_m: float, sight: Sight
) -> NDArray[np.bool_]:
    """[2, K, ACROSS] whether both legs to the pieces of the aperture are free."""
    seen = np.ones((2, len(cells.corner) * ACROSS), dtype=bool)
    corner = np.repeat(cells.corner, ACROSS)
    for order in (0, 1):
        one, faces = FaceOrder.of(cells, views, order), (order, 1 - order)
        b = one.beam(wavelength_m)
        below = (one.height * np.sin(one.angle))[:, None]
        share = below / (below + b * np.sin(one.opening)[:, None])  # of the way from the image to the second face
        a = (one.height * np.sin(one.angle + one.opening))[:, None] * b * share / below
        legs = ((a, cells.z[:, None] * share), (b, np.tile(cells.z[:, None], ACROSS)))
        for face, (away, z) in zip(faces, legs, strict=True):
            here = np.flatnonzero(seen[order])  # what is hidden on the first face need not be looked at on the second
            of, away, z = corner[here], away.reshape(-1)[here], z.reshape(-1)[here]
            point = _points_before_faces(
                of, z, away, views.foot, corners.direction, np.ascontiguousarray(corners.into[:, face]),
                np.ascontiguousarray(corners.normal[:, face]),
            )  # fmt: skip
            seen[order, here] = sight(np.zeros_like(point), point)
    return seen.reshape(2, -1, ACROSS)


@compiled()
def _points_before_faces(corner, z, away, foot, direction, into, normal):
    """[n, 3] points at z along the edge and ``away`` from it in a face, lifted off by the ray caster's error.

    :param corner: [n]; :param z, away: [n] [m]; :param foot, direction, into, normal: [C, 3] of the corners
    """
    points = np.empty((len(corner), 3))
    for n in range(len(corner)):
        c, square = corner[n], 0.0
        for i in range(3):
            points[n, i] = foot[c, i] + z[n] * direction[c, i] + away[n] * into[c, i]
            square += points[n, i] * points[n, i]
        margin = ray_margin_m(np.sqrt(square))
        for i in range(3):
            points[n, i] += margin * normal[c, i]
    return points
