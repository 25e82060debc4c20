"""The radar's field of view, as lines level with the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.view.subject import Subject

ARCS_M = (10.0, 20.0, 40.0, 80.0)
"""Ranges at which the field of view has an arc."""
ARC_POINTS = 49


def field_of_view(subject: Subject) -> list[NDArray[np.float64]]:
    """Lines [n, 3] round what the image covers [m]: its two edges in u, then arcs of equal range."""
    grid, farthest = subject.radar.grid, float(subject.radar.waveform.ranges_m[-1])
    azimuth = np.arcsin(np.clip(np.linspace(grid.u_start, grid.u_stop, ARC_POINTS), -1.0, 1.0))
    arc = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
    radii = [radius for radius in ARCS_M if radius < farthest] or [farthest]
    edges = [np.stack([np.zeros(3), radii[-1] * arc[end]]) for end in (0, -1)]
    return edges + [radius * arc for radius in radii]
