"""The outline of a box in the radar frame, and what it covers of an image's axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.dataset import Box

Real = NDArray[np.float64]

AROUND = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
"""The corners of a footprint, counter-clockwise from the front left one, over length and width."""


def footprint(box: Box, points: int = 1) -> Real:
    """[4 * points, 2] x and y [m] along a box's outline seen from above, counter-clockwise from its front left corner.

    :param points: of each side, its first corner among them
    """
    share = np.arange(points)[:, None] / points
    sides = zip(AROUND, np.roll(AROUND, -1, axis=0), strict=True)
    around = np.concatenate([(1.0 - share) * first + share * second for first, second in sides])
    along = around * np.array(box.size[:2])
    cosine, sine = np.cos(box.yaw), np.sin(box.yaw)
    return np.array(box.center[:2]) + along @ np.array([[cosine, sine], [-sine, cosine]])


def range_and_u(box: Box, points: int = 16) -> tuple[Real, Real]:
    """[4 * points] range [m] and u = sin(azimuth) along a box's footprint, at the height of its middle."""
    x, y = footprint(box, points).T
    range_m = np.sqrt(x**2 + y**2 + box.center[2] ** 2)
    return range_m, y / np.maximum(range_m, 1e-9)
