"""Cubes as ``trainer import`` and users write them, with noise; a radar of another band than the tiny one."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tiny_radar import RADAR

from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal import if_signal
from trainer.captures.cube_file import Capture, write_cube

OTHER = RADAR.waveform.model_copy(
    update={"carrier_hz": 60e9, "bandwidth_hz": 2e9, "chirps": 8, "samples": 64, "range_bins": 40}
)
PLACES = np.array([7.0, 0.0, 4.5, 1.0, 2.0, 6.0, 3.0, 5.0])
"""Of the RX, in units of 2 mm at the run's wavelength: those of the tiny radar, turned about, and two more."""


def other_radar(places: NDArray[np.float64] = PLACES, stretch: float = 1.0, shift_m: float = 0.0) -> Radar:
    """A radar of another band whose elements stand at these places."""
    scale = stretch * OTHER.wavelength_m / RADAR.waveform.wavelength_m
    rx = line(2e-3 * scale * places + shift_m)
    array = AntennaArray(tx_m=RADAR.array.tx_m, rx_m=rx)
    return RADAR.model_copy(update={"name": "other", "waveform": OTHER, "array": array})


def noisy(echo: NDArray[np.complexfloating], radar: Radar, generator: np.random.Generator) -> NDArray[np.complex64]:
    """The samples of echoes with the receiver's noise."""
    noise = generator.standard_normal((*echo.shape, 2)) @ [1.0, 1.0j] * np.sqrt(0.5 * radar.sample_noise_power_w)
    return (echo + noise).astype(np.complex64)


def write_plain_cube(path: Path, cube: NDArray[np.complexfloating], radar: Radar) -> Path:
    """One or several frames as a user may write them, without a capture."""
    np.savez(path, cube=cube.astype(np.complex64), radar=radar.model_dump_json())
    return path


def capture_of(**changes: object) -> Capture:
    fields = {"source": "adc.bin", "source_sha256": "0" * 64, "board": "tiny", "frames": 1, "scale": "relative"}
    return Capture.model_validate({**fields, "noise_power": 1e-20, **changes})


def write_capture(
    path: Path, radar: Radar, positions: Sequence[tuple[float, float, float]] = ((2.0, 0.4, 0.0),), **changes: object
) -> Path:
    """A target of unit amplitude at each position [m], as an imported cube."""
    points = np.array(positions)
    cube = if_signal(radar, points, np.zeros_like(points), np.ones(len(points), complex)).astype(np.complex64)
    write_cube(path, cube[None], radar, capture_of(**changes))
    return path
