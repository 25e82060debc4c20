"""Random targets where telling them apart is hard: groups of one to six at one range, many of them close and equal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.estimators.array import line_array

GROUPS_PER_ROW = (0.01, 0.3)
"""Density of a crop's groups, drawn between these with a uniform logarithm."""
MOST_POINTS = 6
CLUSTERED, NEAR_EQUAL, EXTENDED = 0.5, 0.5, 0.2
"""Shares of the groups: whose points stand close to each other, whose levels are near each other, that are extended."""
GAP_CELLS = (0.12, 3.0)
"""Distance of a clustered point from another of its group, uniform logarithm [resolution cells of the full array]."""
LEVEL_DB = (-5.0, 45.0)
"""Level of a group's strongest point over the noise of a channel, uniform."""
FLASH, FLASH_DB = 0.1, 20.0
"""Share of groups that are stronger by this: the datasets' specular flashes reach 68 dB."""
SPAN_DB, NEAR_SPAN_DB = 25.0, 3.0
"""Levels below the group's strongest, uniform, and those of near-equal groups."""
RANGE_SPREAD_BINS = 0.5
"""Standard deviation of a point's range about its group's."""
EXTENT_CELLS = (0.3, 4.0)
"""Width of an extended target, uniform logarithm."""
SCATTERERS = 24
"""Of an extended target: so many in its width leave no gap that an array could see."""
NEAREST_M = 3.0
"""Range of the nearest targets; nearer, the wave front's curvature needs more than two orders."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Scatterers of one crop.

    :param row: [n] range bin in the crop, not whole
    :param u: [n] within [-1, 1]
    :param amplitude: [n] complex, noise power 1
    :param point: [n] bool, whether it is a target of its own; else it is part of an extended one
    :param first_row: range bin of the crop's first row
    :param extended: [e, 3] row, u and half the width in u of the extended targets
    """

    row: NDArray[np.float64]
    u: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    point: NDArray[np.bool_]
    first_row: float
    extended: NDArray[np.float64]

    def in_extended(self, row: NDArray[np.integer], u: NDArray[np.float64]) -> NDArray[np.bool_]:
        """[m] whether a cell at a row [m] and u [m] belongs to an extended target."""
        of_row = np.abs(row[:, None] - self.extended[:, 0]) <= 1.5
        return np.asarray((of_row & (np.abs(u[:, None] - self.extended[:, 1]) <= self.extended[:, 2])).any(axis=1))


def draw_targets(generator: np.random.Generator, rows: int, radar: Radar) -> Targets:
    """Targets of a crop of ``rows`` range bins, over all of |u| <= 1: what lies outside the image folds into it."""
    cell, waveform = line_array(radar).resolution_cell, radar.waveform
    last_m = waveform.range_bins * waveform.range_step_m
    first_m = _log_uniform(generator, (min(NEAREST_M, last_m), last_m))
    # Targets start one row outside the crop: their echoes reach into it.
    groups = generator.poisson(_log_uniform(generator, GROUPS_PER_ROW) * (rows + 1))
    parts, extended = [_no_scatterers()], np.empty((0, 3))
    for row in generator.uniform(-1.0, rows, groups):
        level_db = generator.uniform(*LEVEL_DB) + FLASH_DB * (generator.random() < FLASH)
        if generator.random() < EXTENDED:
            width = cell * _log_uniform(generator, EXTENT_CELLS)
            centre = generator.uniform(-1.0, 1.0)
            parts.append(_surface(generator, row, centre, width, level_db))
            extended = np.append(extended, [[row, centre, 0.5 * width]], axis=0)
        else:
            parts.append(_points(generator, row, cell, level_db))
    row, u, amplitude, point = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Targets(row, u, amplitude, point.astype(bool), first_m / waveform.range_step_m, extended)


Scatterers = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128], NDArray[np.bool_]]
"""Rows, u, amplitudes and whether they are points."""


def _no_scatterers() -> Scatterers:
    return np.empty(0), np.empty(0), np.empty(0, dtype=np.complex128), np.empty(0, dtype=bool)


def _points(generator: np.random.Generator, row: float, cell: float, level_db: float) -> Scatterers:
    count = int(generator.integers(1, MOST_POINTS + 1))
    u = generator.uniform(-1.0, 1.0, count)
    rows = np.full(count, row)
    if generator.random() < CLUSTERED:
        for place in range(1, count):
            gap = cell * _log_uniform(generator, GAP_CELLS)
            u[place] = u[generator.integers(place)] + gap * (1.0 if generator.random() < 0.5 else -1.0)
    if generator.random() < 0.5:
        rows += generator.normal(0.0, RANGE_SPREAD_BINS, count)
    span = NEAR_SPAN_DB if generator.random() < NEAR_EQUAL else SPAN_DB
    below_db = generator.uniform(0.0, span, count)
    amplitude = 10.0 ** ((level_db - below_db + below_db.min()) / 20.0)
    amplitude = amplitude * np.exp(2j * np.pi * generator.random(count))
    return rows, np.clip(u, -1.0, 1.0), amplitude, np.ones(count, dtype=bool)


def _surface(generator: np.random.Generator, row: float, centre: float, width: float, level_db: float) -> Scatterers:
    u = centre + width * generator.uniform(-0.5, 0.5, SCATTERERS)
    parts = generator.standard_normal((SCATTERERS, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5 / SCATTERERS)
    rows = row + generator.normal(0.0, RANGE_SPREAD_BINS, SCATTERERS)
    return rows, np.clip(u, -1.0, 1.0), 10.0 ** (level_db / 20.0) * parts, np.zeros(SCATTERERS, dtype=bool)


def _log_uniform(generator: np.random.Generator, bounds: tuple[float, float]) -> float:
    low, high = np.log(bounds)
    return float(np.exp(generator.uniform(low, high)))
