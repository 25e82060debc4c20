"""Point targets simulated while training: any number of snapshots with a known truth, where the difficulty is.

A scene fills few of its range bins with echoes that can be told apart, and a dataset ends. Here every training frame is
accompanied by crops of random targets: groups of one to six at one range, many of them close and equal. Input array and
virtual sensor see them at once. An echo of amplitude a at range bin r (not a whole number) and u is, in row p and at a
virtual element that a TX at y_t and an RX at y_r make, with y = y_t + y_r,

    a H(r - p) exp(-j k u y + j k (1 - u^2) (y_t^2 + y_r^2) / (2 d)),    H(o) = exp(j pi o) sinc(o) / (1 - o^2)

with H the spectrum of the Hann window over the range samples and d the target's range: the curvature of the wave front
to second order, less than 0.01 rad of error from 3 m on for an array of 94 mm. One Doppler cell, no range walk. The
truth is the windowed matched filter of the virtual sensor, which knows the curvature, and therefore of plane waves;
noise free. White noise of unit power in every channel is the scale of the amplitudes. Of TX that take turns the
channels are compensated for motion, as in every frame (:mod:`shared.signal.tdm`): what is left is the phase of a
velocity off the centre of its Doppler cell, for each scatterer its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from shared.physics.units import db_to_amplitude, db_to_power
from shared.radar import Radar
from shared.signal.imaging import sensor_weights
from shared.signal.tdm import turns
from shared.signal.windows import hann_spectrum
from trainer.estimators.array import line_array
from trainer.metrics.cells import visible_cells
from trainer.training.losses import spot_image

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


Scatterers = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128], NDArray[np.bool_]]
"""Rows, u, amplitudes and whether they are points."""


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
    parts: list[Scatterers] = [(np.empty(0), np.empty(0), np.empty(0, np.complex128), np.empty(0, np.bool_))]
    extended = np.empty((0, 3))
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
    amplitude = db_to_amplitude(level_db - below_db + below_db.min())
    amplitude = amplitude * np.exp(2j * np.pi * generator.random(count))
    return rows, np.clip(u, -1.0, 1.0), amplitude, np.ones(count, dtype=bool)


def _surface(generator: np.random.Generator, row: float, centre: float, width: float, level_db: float) -> Scatterers:
    u = centre + width * generator.uniform(-0.5, 0.5, SCATTERERS)
    parts = generator.standard_normal((SCATTERERS, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5 / SCATTERERS)
    rows = row + generator.normal(0.0, RANGE_SPREAD_BINS, SCATTERERS)
    return rows, np.clip(u, -1.0, 1.0), db_to_amplitude(level_db) * parts, np.zeros(SCATTERERS, dtype=bool)


def _log_uniform(generator: np.random.Generator, bounds: tuple[float, float]) -> float:
    low, high = np.log(bounds)
    return float(np.exp(generator.uniform(low, high)))


NEIGHBOURS = range(-3, 5)
"""Rows that an echo is added to, from the row below it on; beyond them |H| is below -48 dB."""
LEAST_SUM_DB = 6.0
"""A point is a target from this level on, in the sum of the channels over their noise; below it is noise."""


@dataclass(frozen=True)
class PointCrops:
    """Crops of B places.

    :param range_channel: [B, R, C] complex64, noise power 1
    :param image: [B, R, U] truth relative to its peak
    :param image_peak: [B] float64, that peak; 1 where a crop is empty
    :param spots: [B, R, U] where the targets are, see :mod:`trainer.training.losses`
    :param first_row: [B] range bin of the first row
    """

    range_channel: torch.Tensor
    image: torch.Tensor
    image_peak: torch.Tensor
    spots: torch.Tensor
    first_row: NDArray[np.float64]


class OnlinePoints:
    """Crops of point targets for one radar.

    :param truth_window: over the virtual sensor's elements, of :data:`shared.processes.defaults.ANGLE_WINDOWS`
    :param channels: that the network sees; the more, the weaker a target may be that still is one
    """

    def __init__(self, radar: Radar, truth_window: str, channels: int) -> None:
        sensor, array = radar.virtual_sensor, radar.array
        wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
        self._radar, self._channels = radar, array.channels
        self._turns = turns(radar)
        self._phase = wavenumber * np.concatenate([array.virtual[:, 1], sensor.virtual[:, 1]])
        self._curvature = np.concatenate([line_array(radar).bend_phase(np.ones(1))[0], np.zeros(sensor.channels)])
        self._matched = torch.from_numpy(sensor_weights(radar, truth_window).astype(np.complex64))
        self._least = np.sqrt(db_to_power(LEAST_SUM_DB) / channels)
        self._seen_by = channels

    def __call__(self, seed: int, step: int, places: range, rows: int, device: torch.device) -> PointCrops:
        """The crops of these places of the batch of all processes: a function of seed, step and place alone."""
        generators = [np.random.default_rng([seed, step, 1, place]) for place in places]
        drawn = [draw_targets(generator, rows, self._radar) for generator in generators]
        shape = (rows, self._channels, 2)
        noise = [generator.standard_normal(shape, dtype=np.float32) * np.float32(0.5**0.5) for generator in generators]
        snapshots = torch.from_numpy(np.stack(noise).view(np.complex64)[..., 0]).to(device)
        off_cell = None
        if self._turns.any():
            pairs = zip(generators, drawn, strict=True)
            off_cell = np.concatenate([generator.uniform(-0.5, 0.5, len(targets.row)) for generator, targets in pairs])
        image = self._echoes(drawn, snapshots, off_cell)
        peak = image.amax(dim=(-2, -1))
        peak = torch.where(peak > 0, peak, 1.0)
        return PointCrops(
            snapshots,
            image / peak[:, None, None],
            peak.double(),
            self._spots(drawn, image.cpu().numpy()).to(device),
            np.array([targets.first_row for targets in drawn]),
        )

    def _echoes(
        self, drawn: list[Targets], snapshots: torch.Tensor, off_cell: NDArray[np.float64] | None = None
    ) -> torch.Tensor:
        """[B, R, U] the virtual sensor's image; the input array's echoes are added to ``snapshots`` [B, R, C].

        :param off_cell: [n] velocities of all scatterers, in Doppler cells off the centres of theirs
        """
        crops, rows, channels = snapshots.shape
        device = snapshots.device
        crop = np.repeat(np.arange(crops), [len(targets.row) for targets in drawn])
        row, u, amplitude = (
            np.concatenate([getattr(targets, name) for targets in drawn]) for name in ("row", "u", "amplitude")
        )
        first = np.array([targets.first_row for targets in drawn])[crop]
        distance_m = np.maximum((first + row) * self._radar.waveform.range_step_m, NEAREST_M)
        turned = -u[:, None] * self._phase + ((1.0 - u**2) / distance_m)[:, None] * self._curvature
        if off_cell is not None:
            turned[:, :channels] += 2.0 * np.pi / self._radar.waveform.chirps * off_cell[:, None] * self._turns
        # float32 keeps phases below a thousand radians to 1e-4.
        phase = torch.from_numpy(turned).float().to(device)
        echo = torch.polar(torch.ones_like(phase), phase)  # (n, C + V)
        seen = torch.zeros(crops * rows, echo.shape[1], dtype=torch.complex64, device=device)
        for offset in NEIGHBOURS:
            place = np.floor(row).astype(int) + offset
            inside = (place >= 0) & (place < rows)
            weight = (amplitude * hann_spectrum(row - place))[inside].astype(np.complex64)
            target = torch.from_numpy((crop * rows + place)[inside]).to(device)
            seen.index_add_(0, target, torch.from_numpy(weight)[:, None].to(device) * echo[torch.from_numpy(inside)])
        seen = seen.reshape(crops, rows, -1)
        snapshots += seen[..., :channels]
        return (seen[..., channels:] @ self._matched.to(device)).abs()

    def _spots(self, drawn: list[Targets], images: NDArray[np.float32]) -> torch.Tensor:
        """Spots of the points themselves, and of an extended target's maxima in the truth."""
        grid, made = self._radar.grid, []
        for targets, image in zip(drawn, images, strict=True):
            points = targets.point & (np.abs(targets.amplitude) > self._least)
            row, place = targets.row[points], (targets.u[points] - grid.u[0]) / grid.step
            if len(targets.extended):
                cells = visible_cells(image, 1.0, self._seen_by)
                of_extended = targets.in_extended(cells[:, 0], grid.u[cells[:, 1]])
                row = np.concatenate([row, cells[of_extended, 0]])
                place = np.concatenate([place, cells[of_extended, 1]])
            made.append(spot_image(len(image), grid.bins, row, place))
        return torch.from_numpy(np.stack(made))
