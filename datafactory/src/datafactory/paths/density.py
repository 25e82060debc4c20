"""Paths by resolution cell of the truth: their power there, and how densely they sample it.

Speckle needs several scatterers in a resolution cell to be speckle. A rough surface's echo in a cell is a sum of many
contributions. Where only a few rays stand for it, the cell shows the rays rather than the surface; such cells are
counted, so that a dataset says how much of it they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.paths.table import PathTable
from shared.physics.vectors import Index, Real, lengths
from shared.radar import Radar
from shared.signal.windows import angle_window, point_spread

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
    distance = lengths(scattered.rx_point)
    u = scattered.rx_point[:, 1] / np.where(distance > 0.0, distance, 1.0)
    row = np.floor(scattered.range_m() / radar.waveform.range_step_m).astype(np.int64)
    inside = (row < radar.waveform.range_bins) & (u >= grid.u_start) & (u < grid.u_stop)
    column = np.floor((u[inside] - grid.u_start) / width).astype(np.int64)
    paths_in = np.bincount(row[inside] * (int(2.0 / width) + 1) + column)
    lit = paths_in[paths_in > 0]
    return {"cells_lit": len(lit), "cells_lit_by_fewer_than_5_paths": int((lit < FEW_PATHS).sum())}


@dataclass(frozen=True, eq=False)
class CellMap:
    """Which resolution cell of the truth each path lies in, scattered paths first.

    Cells are one range bin times the truth's -3 dB width in u.

    :param shape: R, U'
    :param cell: [K] number of the path's cell, row by row; that of the first for paths beyond the last range bin
    :param power: [K] of the path [W]; 0 for paths beyond the last range bin
    """

    shape: tuple[int, int]
    cell: Index
    power: Real

    def sums(self, weight: Real | float = 1.0, index: Index | slice = slice(None)) -> Real:
        """[R, U'] power [W] of the paths in every cell, summed without phase.

        That is the expectation of |sum A|^2 over random phases (Goodman, Speckle Phenomena in Optics, section 2.1), so
        that no image of many realisations is needed.

        :param weight: of each path's power, or of all
        :param index: of the paths that are summed; the weights are theirs
        """
        power = self.power[index] * weight

        sums = np.bincount(self.cell[index], power, self.shape[0] * self.shape[1])
        return sums.astype(np.float64, copy=False).reshape(self.shape)


def cell_map(paths: PathTable, radar: Radar, truth_window: str) -> CellMap:
    """The cells of a table's paths.

    :param truth_window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    """
    range_m = np.concatenate([paths.scattered.range_m(), paths.specular.range_m()])
    arrival = np.concatenate([paths.scattered.rx_point, paths.specular.image])
    power = np.abs(np.concatenate([paths.scattered.amplitude, paths.specular.amplitude])) ** 2
    row, column, columns = cell_numbers(range_m, arrival, radar, truth_window)
    inside = row < radar.waveform.range_bins
    cell = np.where(inside, row * columns + column, 0)
    return CellMap((radar.waveform.range_bins, columns), cell, np.where(inside, power, 0.0))


def cell_numbers(range_m: Real, arrival: Real, radar: Radar, truth_window: str) -> tuple[Index, Index, int]:
    """Range bin [K] and column in u [K] of echoes, and the number of columns: one range bin times the truth's -3 dB
    width.

    :param range_m: [K] [m]; :param arrival: [K, 3] points from which they come [m]
    """
    elements, wavelength = radar.virtual_sensor.channels, radar.waveform.wavelength_m
    aperture = float(np.ptp(radar.virtual_sensor.rx[:, 1]))
    spacing = aperture / (elements - 1) / wavelength if elements > 1 else 0.5
    width, _ = point_spread(angle_window(truth_window, elements), spacing)
    columns = int(np.ceil(2.0 / width))
    u = arrival[:, 1] / np.maximum(lengths(arrival), 1e-9)
    row = np.rint(range_m / radar.waveform.range_step_m).astype(np.int64)
    return row, np.clip(((u + 1.0) / width).astype(np.int64), 0, columns - 1), columns


def cell_power(paths: PathTable, radar: Radar, truth_window: str, weight: Real | float = 1.0) -> Real:
    """[R, U'] power [W] of the paths in every resolution cell of the truth, see :meth:`CellMap.sums`."""
    return cell_map(paths, radar, truth_window).sums(weight)
