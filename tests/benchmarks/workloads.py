"""What is synthesised in the benchmarks: seeded paths, sizes, and results that several comparisons share."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from oracles import delays
from record import Timing, timed

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray, virtual_sensor_256
from shared.radar.waveform import Waveform

SEED = 20_240
EGO_SPEED_MPS = 10.0
DIRECT_CHUNK = 64
"""Paths summed at once: 1024 samples of them fit the second cache."""


@dataclass(frozen=True)
class Size:
    """How much is computed.

    :param name: "full" are the sizes that the results are quoted at
    :param paths: K of the cubes
    :param direct_samples: channel-chirps of the moving cube on which the reference is run
    :param waveform: of the cubes and images
    :param elements: of the virtual sensor, half of a carrier wavelength apart
    :param angle_bins: of the images
    :param repeats: of which the median is taken
    """

    name: str
    paths: int
    direct_samples: int
    waveform: Waveform
    elements: int
    angle_bins: int
    repeats: int


FULL = Size(
    name="full",
    paths=100_000,
    direct_samples=4,
    waveform=Waveform(),
    elements=256,
    angle_bins=450,
    repeats=5,
)
QUICK = replace(
    FULL,
    name="quick",
    paths=5_000,
    angle_bins=90,
    repeats=2,
)


def street(paths: int, speed_mps: float, seed: int = SEED) -> PathTable:
    """Single bounces over the field of view from 3 to 85 m, amplitudes as 1 / R^2, approached at ``speed_mps``."""
    generator = np.random.default_rng(seed)
    range_m = generator.uniform(3.0, 85.0, paths)
    u, z = generator.uniform(-0.85, 0.85, paths), generator.uniform(-0.05, 0.05, paths)
    direction = np.stack([np.sqrt(1.0 - u**2 - z**2), u, z], axis=1)
    amplitude = range_m**-2 * np.exp(2j * np.pi * generator.uniform(size=paths))
    velocity = np.tile([-speed_mps, 0.0, 0.0], (paths, 1))
    return PathTable(ScatteredPaths.of_points(range_m[:, None] * direction, velocity, amplitude))


def direct_sum(paths: PathTable, radar: Radar, array: AntennaArray, channel: int, chirp: int) -> NDArray[np.complex128]:
    """[samples] eq. (1) summed in float64 for one channel and chirp, in NumPy, some paths at a time."""
    waveform = radar.waveform
    tx, rx = array.tx[array.channel_tx[channel]], array.rx[array.channel_rx[channel]]
    tau = delays(paths, tx, rx, chirp * waveform.chirp_interval_s)
    frequency = waveform.carrier_hz + waveform.bandwidth_hz * np.arange(waveform.samples) / waveform.samples
    amplitude = paths.scattered.amplitude
    signal = np.zeros(waveform.samples, dtype=np.complex128)
    for first in range(0, len(tau), DIRECT_CHUNK):
        chunk = slice(first, first + DIRECT_CHUNK)
        cycles = frequency[:, None] * tau[chunk]
        signal += np.exp(2j * np.pi * (cycles - np.rint(cycles))) @ amplitude[chunk]
    return signal


class Workload:
    """The moving frame of one size, and what several comparisons need of it, each computed once."""

    def __init__(self, size: Size) -> None:
        self.size = size
        full = virtual_sensor_256(size.waveform.carrier_hz)
        middle = slice((256 - size.elements) // 2, (256 + size.elements) // 2)
        self.sensor = AntennaArray(tx_m=full.tx_m, rx_m=full.rx_m[middle])
        self.radar = Radar(waveform=size.waveform, virtual_sensor=self.sensor, grid=ImageGrid(bins=size.angle_bins))

    @cached_property
    def paths(self) -> PathTable:
        """K paths seen from an ego vehicle at EGO_SPEED_MPS."""
        return street(self.size.paths, EGO_SPEED_MPS)

    @cached_property
    def cube(self) -> tuple[Timing, NDArray[np.complex64]]:
        """Time and result of the moving cube at 1e-6 on one thread."""
        elapsed, cube = self.cube_at(1e-6)
        return elapsed, cube.astype(np.complex64, copy=False)

    def cube_at(self, tolerance: float) -> tuple[Timing, NDArray]:
        """Time and result of the moving cube, after a warm-up with few paths."""
        cube_of_paths(street(32, EGO_SPEED_MPS), self.radar, tolerance)
        return timed(lambda: cube_of_paths(self.paths, self.radar, tolerance), self.size.repeats)

    @cached_property
    def channel_chirps(self) -> int:
        """Channels times chirps of the moving cube."""
        return self.radar.array.channels * self.radar.waveform.chirps

    def sample(self, count: int) -> list[tuple[int, int]]:
        """Seeded (channel, chirp) pairs, each at most once."""
        chosen = np.random.default_rng(SEED).choice(self.channel_chirps, min(count, self.channel_chirps), replace=False)
        return [(int(index) % self.radar.array.channels, int(index) // self.radar.array.channels) for index in chosen]

    @cached_property
    def direct(self) -> tuple[Timing, NDArray[np.complex128]]:
        """Time and [pairs, samples] of the float64 sum on the seeded sample of channel-chirps."""
        pairs = self.sample(self.size.direct_samples)
        return timed(lambda: np.stack([direct_sum(self.paths, self.radar, self.radar.array, *p) for p in pairs]), 1)

    def error_against_direct(self, cube: NDArray) -> float:
        """Relative L2 error of the cube on the direct sum's sample."""
        reference = self.direct[1]
        ours = np.stack([cube[chirp, :, channel] for channel, chirp in self.sample(self.size.direct_samples)])
        return float(np.linalg.norm(ours - reference) / np.linalg.norm(reference))
