"""How densely the paths sample the image: speckle needs several scatterers in a resolution cell to be speckle.

A rough surface's echo in a cell is a sum of many contributions. Where only a few rays stand for it, the cell shows the
rays rather than the surface; such cells are counted, so that a dataset says how much of it they are.
"""

from __future__ import annotations

import numpy as np

from datafactory.paths.table import PathTable
from shared.radar import Radar

FEW_PATHS = 5
"""Below five the amplitude of the sum is visibly not Rayleigh distributed."""


def lit_cells(paths: PathTable, radar: Radar) -> dict[str, int]:
    """Resolution cells of the truth that scattered paths light, and how many of them fewer than five.

    A cell is one range bin by the virtual sensor's Rayleigh length in u, lambda / (elements * spacing).
    """
    scattered, grid = paths.scattered, radar.grid
    y = radar.virtual_sensor.rx[:, 1]
    aperture = float(np.ptp(y)) * len(y) / max(len(y) - 1, 1)
    width = radar.waveform.wavelength_m / aperture if aperture > 0.0 else 2.0
    distance = np.linalg.norm(scattered.rx_point, axis=1)
    u = scattered.rx_point[:, 1] / np.where(distance > 0.0, distance, 1.0)
    row = np.floor(scattered.range_m() / radar.waveform.range_step_m).astype(np.int64)
    inside = (row < radar.waveform.range_bins) & (u >= grid.u_start) & (u < grid.u_stop)
    column = np.floor((u[inside] - grid.u_start) / width).astype(np.int64)
    _, lit = np.unique(np.stack([row[inside], column]), axis=1, return_counts=True)
    return {"cells_lit": len(lit), "cells_lit_by_fewer_than_5_paths": int((lit < FEW_PATHS).sum())}
