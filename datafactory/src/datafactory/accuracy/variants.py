"""Approximations that the pipeline does not make, built from its own parts so that their price can be shown.

Each is a change of the path table, whose delays one kernel then evaluates exactly:

* linear delays: every point moves along its line of sight from the origin at mid-frame alone, so that its distance is
  linear in time and its direction fixed. In this kernel it costs what exact delays cost.
* float32 geometry: coordinates and velocities rounded to float32, delays still evaluated in float64.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable
from datafactory.paths.unfold import unit
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.imaging import sweep_moments
from shared.signal.windows import hann

REFERENCE_BLOCK = 32
"""Elements of the virtual sensor whose full cube is held at a time: 64 MB for the default waveform."""

Real = NDArray[np.float64]


class SphereLattice(RayFan):
    """The solver's own first directions: a Fibonacci lattice over the whole sphere, shifted by the same offset."""

    aimable = False

    def unit_square(self) -> Real:
        """[count, 2] points of the unit square, see :meth:`RayFan.unit_square`."""
        index = np.arange(self.count)
        across = (index / ((1.0 + np.sqrt(5.0)) / 2.0) + self.offset[0]) % 1.0
        return np.stack([across, ((index + 0.5) / self.count + self.offset[1]) % 1.0], axis=1)

    def solid_angle_ratio(self, directions: Real) -> Real:
        """[K] ones: every ray stands for 4 pi / count."""
        return np.ones(len(directions))


class FrontOfSphere(SphereLattice):
    """The same lattice, of which only the rays into the fan's half space count; the others are lost."""

    def solid_angle_ratio(self, directions: Real) -> Real:
        """[K] 1 ahead, 0 behind."""
        return (directions[:, 0] >= 0.0).astype(np.float64)


FAN, SPHERE = "fan", "sphere"
LATTICES = {FAN: RayFan, SPHERE: FrontOfSphere, "all around": SphereLattice}
"""First directions by name."""
AHEAD = -1e-6
"""Directions with x above this are ahead: those straight below, at 0 but for rounding, are."""


def ahead_alone(paths: PathTable) -> PathTable:
    """Without the paths of rays that the fan does not send: amplitude zero, or mirrors behind at both ends."""
    scattered, specular = paths.scattered, paths.specular
    ahead = (specular.departure()[:, 0] >= AHEAD) | (specular.image[:, 0] >= AHEAD)
    return replace(
        paths,
        scattered=scattered.take(np.flatnonzero(scattered.amplitude != 0.0)),
        specular=specular.take(np.flatnonzero(ahead)),
    )


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


def reference_moments(
    paths: PathTable,
    radar: Radar,
    doppler_cells: NDArray[np.int64],
    terms: int,
    intra_chirp: bool = False,
    tolerance: float = 1e-6,
) -> NDArray[np.complex64]:
    """[terms, R, C] what :func:`truth_moments` approximates: from its whole cube and Doppler filters."""
    waveform, sensor = radar.waveform, radar.virtual_sensor
    window = hann(waveform.chirps) / hann(waveform.chirps).sum()
    turn = np.arange(waveform.chirps) / waveform.chirps
    moments = np.empty((terms, waveform.range_bins, sensor.channels), dtype=np.complex64)
    for first in range(0, len(sensor.rx_m), REFERENCE_BLOCK):
        block = slice(first, first + REFERENCE_BLOCK)
        some = AntennaArray(tx_m=sensor.tx_m, rx_m=sensor.rx_m[block])
        cube = cube_of_paths(paths, radar, tolerance, some, intra_chirp=intra_chirp)
        for cell in np.unique(doppler_cells):
            rows = np.flatnonzero(doppler_cells == cell)
            weight = window * np.exp(-2j * np.pi * (cell - waveform.chirps // 2) * turn)
            filtered = np.tensordot(weight.astype(cube.dtype), cube, axes=1)
            moments[:, rows, block] = sweep_moments(filtered, radar, terms)[:, rows]
    return moments
