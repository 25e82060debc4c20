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
    for order in (0, 1):
        b = FaceOrder.of(cells, views, order).beam(wavelength_m)
        angle = views.angle if order == 0 else views.opening - views.angle
        below, above = (views.height * np.sin(phi) for phi in (angle, angle + views.opening))
        for leg, face in enumerate((order, 1 - order)):
            here = np.flatnonzero(seen[order])  # what is hidden on the first face need not be looked at on the second
            point = _points_before_faces(
                here, leg == 0, (cells.corner, cells.z, b), (below, above, np.sin(views.opening)),
                (views.foot, corners.direction),
                (np.ascontiguousarray(corners.into[:, face]), np.ascontiguousarray(corners.normal[:, face])),
            )  # fmt: skip
            seen[order, here] = sight(np.zeros_like(point), point)
    return seen.reshape(2, -1, ACROSS)


@compiled()
def _points_before_faces(pieces, first, cells, bend, edge, face):
    """[n, 3] where the waves of pieces of the aperture meet a face, lifted off by the ray caster's error.

    :param pieces: [n] K-th cell times ``ACROSS`` and the piece of it; :param first: on the first face, or the second
    :param cells: corner [K], z along the edge [K] and b on the second face [K, ACROSS] [m]
    :param bend: h sin(phi) [C], h sin(phi + psi) [C], sin(psi) [C]
    :param edge: foot [C, 3], direction [C, 3]; :param face: into [C, 3], normal [C, 3] of the one that is met
    """
    corner, along, across = cells
    below, above, opening = bend
    foot, direction = edge
    into, normal = face
    points = np.empty((len(pieces), 3))
    for n in range(len(pieces)):
        k = pieces[n] // ACROSS
        c, z, away, square = corner[k], along[k], across[k, pieces[n] % ACROSS], 0.0
        if first:
            share = below[c] / (below[c] + away * opening[c])  # of the way from the image to the second face
            away, z = above[c] * away * share / below[c], z * share
        for i in range(3):
            points[n, i] = foot[c, i] + z * direction[c, i] + away * into[c, i]
            square += points[n, i] * points[n, i]
        margin = ray_margin_m(np.sqrt(square))
        for i in range(3):
            points[n, i] += margin * normal[c, i]
    return points
