"""Approximations that the pipeline does not make, built from its own stages so that their price can be shown.

Each is a change of the path table, whose delays one kernel then evaluates exactly:

* linear delays: every point moves along its line of sight from the origin at mid-frame alone, so that its distance is
  linear in time and its direction fixed. In this kernel it costs what exact delays cost.
* plane waves: every point is put D = 1e6 m away in its own direction and the difference is taken off the length
  between, so that |x_i - p| becomes |p| - x_i . p / |p|. The rest, L^2 / 2 D, is 1e-9 m over the input array.
* float32 geometry: coordinates and velocities rounded to float32, delays still evaluated in float64.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.paths.unfold import unit
from datafactory.synthesis.cube import cube_of_paths
from shared.arrays import AntennaArray
from shared.imaging import sweep_moments
from shared.radar import Radar
from shared.signal import chirp_times
from shared.windows import hann

FAR_M = 1e6
REFERENCE_BLOCK = 32
"""Elements of the virtual sensor whose full cube is held at a time: 64 MB for the default waveform."""

Real = NDArray[np.float64]


class SphereLattice(RayFan):
    """The solver's own first directions: a Fibonacci lattice over the whole sphere, shifted by the same offset."""

    def unit_square(self) -> Real:
        """[count, 2] points of the unit square, see :meth:`RayFan.unit_square`."""
        index = np.arange(self.count)
        across = (index / ((1.0 + np.sqrt(5.0)) / 2.0) + self.offset[0]) % 1.0
        return np.stack([across, ((index + 0.5) / self.count + self.offset[1]) % 1.0], axis=1)

    def solid_angle_ratio(self, directions: Real) -> Real:
        """[K] ones: every ray stands for 4 pi / count."""
        return np.ones(len(directions))


def linear_delays(paths: PathTable, radar: Radar) -> PathTable:
    """The table with delays that are linear in time as seen from the origin."""
    time = radar.waveform.mid_frame_s

    def straight(point: Real, velocity: Real) -> tuple[Real, Real]:
        middle = point + velocity * time
        sight = unit(middle)
        radial = sight * np.einsum("ki,ki->k", sight, velocity)[:, None]
        return middle - radial * time, radial

    scattered, specular = paths.scattered, paths.specular
    tx_point, tx_velocity = straight(scattered.tx_point, scattered.tx_velocity)
    rx_point, rx_velocity = straight(scattered.rx_point, scattered.rx_velocity)
    image, image_velocity = straight(specular.image, specular.image_velocity)
    return replace(
        paths,
        scattered=replace(
            scattered, tx_point=tx_point, rx_point=rx_point, tx_velocity=tx_velocity, rx_velocity=rx_velocity
        ),
        specular=replace(specular, image=image, image_velocity=image_velocity),
    )


def float32_geometry(paths: PathTable) -> PathTable:
    """The table with every float64 array rounded to float32 and widened again."""

    def rounded(part):
        changed = {
            item.name: getattr(part, item.name).astype(np.float32).astype(np.float64)
            for item in fields(part)
            if getattr(part, item.name).dtype == np.float64
        }
        return replace(part, **changed)

    return replace(paths, scattered=rounded(paths.scattered), specular=rounded(paths.specular))


def plane_waves(paths: PathTable, time_s: float) -> PathTable:
    """A table at rest: the paths at ``time_s`` [s] as plane waves over every array near the origin."""
    scattered, specular = paths.scattered, paths.specular
    tx_point = scattered.tx_point + scattered.tx_velocity * time_s
    rx_point = scattered.rx_point + scattered.rx_velocity * time_s
    legs = np.linalg.norm(tx_point, axis=1) + np.linalg.norm(rx_point, axis=1)
    between = scattered.between_m + scattered.between_rate_mps * time_s + legs - 2.0 * FAR_M
    image = specular.image + specular.image_velocity * time_s
    departure = unit(np.einsum("kji,kj->ki", specular.axes, -image))
    both = ScatteredPaths.concatenate([scattered, specular.as_scattered(specular.reference)])
    at_rest = np.zeros((len(both), 3))
    return PathTable(
        scattered=replace(
            both,
            tx_point=FAR_M * np.concatenate([unit(tx_point), departure]),
            rx_point=FAR_M * np.concatenate([unit(rx_point), unit(image)]),
            tx_velocity=at_rest,
            rx_velocity=at_rest,
            between_m=np.concatenate(
                [between, np.linalg.norm(image, axis=1) + departure @ specular.reference - 2.0 * FAR_M]
            ),
            between_rate_mps=np.zeros(len(both)),
        ),
        specular=SpecularPaths.none(),
        objects=paths.objects,
        counts=paths.counts,
    )


def plane_wave_cube(paths: PathTable, radar: Radar, tolerance: float) -> NDArray:
    """[chirps, samples, channels] like :func:`cube_of_paths`, with plane waves over the array, chirp by chirp."""
    array, waveform = radar.array, radar.waveform
    single = radar.model_copy(update={"waveform": waveform.model_copy(update={"chirps": 1})})
    times = chirp_times(radar)
    groups = [(array.tx_m, times[0])]
    if not np.all(times == times[0]):
        groups = [((position,), times[index]) for index, position in enumerate(array.tx_m)]
    parts = []
    for tx_m, starts in groups:
        some = AntennaArray(tx_m=tx_m, rx_m=array.rx_m)
        chirps = [cube_of_paths(plane_waves(paths, float(start)), single, tolerance, some)[0] for start in starts]
        parts.append(np.stack(chirps).reshape(waveform.chirps, waveform.samples, len(array.rx_m), len(tx_m)))
    return np.concatenate(parts, axis=3).reshape(waveform.chirps, waveform.samples, array.channels)


def reference_moments(
    paths: PathTable, radar: Radar, doppler_cells: NDArray[np.int64], terms: int, tolerance: float = 1e-6
) -> NDArray[np.complex64]:
    """[terms, R, C] what :func:`truth_moments` approximates: from its whole cube and Doppler filters."""
    waveform, sensor = radar.waveform, radar.virtual_sensor
    window = hann(waveform.chirps) / hann(waveform.chirps).sum()
    turn = np.arange(waveform.chirps) / waveform.chirps
    moments = np.empty((terms, waveform.range_bins, sensor.channels), dtype=np.complex64)
    for first in range(0, len(sensor.rx_m), REFERENCE_BLOCK):
        block = slice(first, first + REFERENCE_BLOCK)
        some = AntennaArray(tx_m=sensor.tx_m, rx_m=sensor.rx_m[block])
        cube = cube_of_paths(paths, radar, tolerance, some)
        for cell in np.unique(doppler_cells):
            rows = np.flatnonzero(doppler_cells == cell)
            weight = window * np.exp(-2j * np.pi * (cell - waveform.chirps // 2) * turn)
            filtered = np.tensordot(weight.astype(cube.dtype), cube, axes=1)
            moments[:, rows, block] = sweep_moments(filtered, radar, terms)[:, rows]
    return moments
