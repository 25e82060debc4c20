"""A tiny radar and datasets of it: what the trainer's tests train on in seconds."""

from pathlib import Path

import numpy as np
from small_dataset import write, write_manifest

from shared.dataset import Frame
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal.imaging import steering_matrix, steering_weights
from trainer.run.configuration import FitConfig

RADAR = Radar(
    name="tiny",
    waveform=Waveform(chirps=4, samples=32, range_bins=24),
    array=AntennaArray(tx_m=line(np.array([0.0])), rx_m=line(2e-3 * np.array([0.0, 1.0, 2.0, 3.0, 6.0, 7.0]))),
    grid=ImageGrid(u_start=-0.5, u_stop=0.5, bins=20),
    virtual_sensor=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(-8.0, 9.0))),
)
NOISE_POWER = 1e-18
TINY = FitConfig(
    width=4, hidden=16, batch=2, steps=4, rows=0, augment=False, points=0, validate_every=2, learning_rate=3e-3, seed=3
)


def tiny(**changes: object) -> FitConfig:
    """:data:`TINY` with changes, checked as a run's is; what a network sees follows from it where it is not stated."""
    return FitConfig.model_validate({**TINY.model_dump(exclude={"features"}), **changes})


def frame(index: int, radar: Radar = RADAR) -> Frame:
    """One or two point targets in every third range bin, amplitudes falling with range; no range sidelobes."""
    generator = np.random.default_rng([7, index])
    rows, bins, channels = radar.waveform.range_bins, radar.grid.bins, radar.array.channels
    response = np.conj(steering_weights(radar, np.arange(channels)) * channels)  # (C, U) echo of each pixel
    psf = steering_matrix(radar, radar.virtual_sensor) / radar.virtual_sensor.channels
    sharp = np.conj(steering_matrix(radar, radar.virtual_sensor))
    snapshots = np.sqrt(NOISE_POWER / 2) * (generator.standard_normal((3, rows, channels, 2)) @ np.array([1, 1j]))
    image = np.zeros((rows, bins), complex)
    for row in range(1, rows, 3):
        for u in generator.choice(bins, generator.integers(1, 3), replace=False):
            amplitude = 1e-6 / row**2 * np.exp(2j * np.pi * generator.random())
            snapshots[:, row] += amplitude * response[:, u]
            image[row] += amplitude * (sharp[:, u] @ psf)
    magnitude = np.abs(image)
    return Frame(
        index, "points", "none", index, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
        range_channel=snapshots.astype(np.complex64),
        velocity=np.tile(np.array([[0.0], [1.0], [-2.0]], np.float32), (1, rows)),
        image=(magnitude / magnitude.max()).astype(np.float32),
        image_peak=float(magnitude.max()),
        noise_power=NOISE_POWER,
    )  # fmt: skip


def write_dataset(directory: Path, frames: dict[str, list[Frame]], radar: Radar = RADAR) -> Path:
    """A dataset of these frames, one shard a split, one row a group."""
    for split, of_split in frames.items():
        write(directory / split / "part-00000.parquet", of_split, radar=radar)
    write_manifest(directory, {f"{split}/part-00000.parquet": len(of_split) for split, of_split in frames.items()})
    return directory


def small_dataset(directory: Path, training: int = 8, validation: int = 2, radar: Radar = RADAR) -> Path:
    return write_dataset(
        directory,
        {
            "train": [frame(index) for index in range(training)],
            "validation": [frame(100 + index) for index in range(validation)],
            "test": [frame(200)],
        },
        radar,
    )
