"""Raw captures of simulated echoes, written number by number as the documents of each format have it.

These loops are the readers' oracle: slow, and each a transcription of its table (SWRA581B for the DCA1000,
``read_ADC_bin_TDA2_separateFiles.m`` for the cascade).
"""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar, load_radar
from shared.signal.signal import if_signal

COUNTS = 1000.0
"""Of an echo of amplitude 1."""

CHIRPS = """
start_frequency_hz = 77e9
slope_hz_per_s = 30e12
idle_time_s = 7e-6
adc_start_time_s = 5e-6
ramp_end_time_s = 40e-6
samples = 32
sample_rate_hz = 2e6
chirps = 4
"""


CFG = """
% a comment
sensorStop
channelCfg 15 5 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 20 1 256 5209 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
chirpCfg 1 1 0 0 0 0 0 4
frameCfg 0 1 16 0 100 1 0
"""
"""The chirps of a board as the SDK's configuration has them."""


def radar_file(folder: Path, board: str, more: str = "") -> Path:
    path = folder / "capture.toml"
    path.write_text(f'board = "{board}"\n[capture]\n{CHIRPS}{more}\n', encoding="utf-8")
    return path


def radar_of(folder: Path, board: str, more: str = "") -> Radar:
    return load_radar(str(radar_file(folder, board, more)))


def scene(radar: Radar, frames: int = 1, noise: float = 0.01) -> NDArray[np.complex128]:
    """[frame, chirp, sample, C] echoes of a mover and of one that stands, with noise: no sample is like another."""
    generator = np.random.default_rng(7)
    positions = np.array([[2.0, 0.5, 0.0], [3.4, -0.9, 0.1]])
    cube = if_signal(radar, positions, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.array([0.7, 0.5 + 0.2j]))
    shape = (frames, *cube.shape)
    return cube + noise * (generator.standard_normal((*shape, 2)) @ np.array([1.0, 1.0j]))


def counts(value: float) -> bytes:
    return struct.pack("<h", round(COUNTS * value))


def write_two_lanes(
    path: Path, cube: NDArray[np.complex128], radar: Radar, real: bool = False, swap: bool = False
) -> None:
    """xWR16xx, xWR18xx: RX after RX; I0 I1 Q0 Q1 I2 I3 Q2 Q3 ...; of real samples one after the other."""
    tx_count, rx_count = len(radar.array.tx_m), len(radar.array.rx_m)
    content = bytearray()
    for frame in cube:
        for chirp in frame:
            for tx in range(tx_count):
                for rx in range(rx_count):
                    samples = chirp[:, tx_count * rx + tx]
                    if real:
                        for sample in samples:
                            content += counts(sample.real)
                        continue
                    for first in range(0, len(samples), 2):
                        pair = samples[first : first + 2]
                        for part in ("imag", "real") if swap else ("real", "imag"):
                            for sample in pair:
                                content += counts(getattr(sample, part))
    path.write_bytes(bytes(content))


def write_four_lanes(
    path: Path, cube: NDArray[np.complex128], radar: Radar, lanes: tuple[int, ...], real: bool = False
) -> None:
    """xWR12xx, xWR14xx: sample after sample, I of four lanes, then Q of four lanes; a lane that is off holds 0."""
    tx_count = len(radar.array.tx_m)
    content = bytearray()
    for frame in cube:
        for chirp in frame:
            for tx in range(tx_count):
                for sample in chirp:
                    for part in ("real",) if real else ("real", "imag"):
                        for lane in range(4):
                            on = lane in lanes
                            value = sample[tx_count * lanes.index(lane) + tx] if on else 0j
                            content += counts(getattr(value, part))
    path.write_bytes(bytes(content))


def write_cascade(folder: Path, cube: NDArray[np.complex128], radar: Radar, index: bool = True) -> None:
    """Four files: loop, TX, sample, RX of the device, I then Q; the master has RX 1 to 4."""
    tx_count = len(radar.array.tx_m)
    for device, name in enumerate(("master", "slave1", "slave2", "slave3")):
        content = bytearray()
        for frame in cube:
            for loop in frame:
                for tx in range(tx_count):
                    for sample in loop:
                        for rx in range(4 * device, 4 * device + 4):
                            value = sample[tx_count * rx + tx]
                            content += counts(value.real) + counts(value.imag)
        (folder / f"{name}_0000_data.bin").write_bytes(bytes(content))
        if index:
            header = struct.pack("<IIIIQ", 1, 1, 0, len(cube), len(content))
            (folder / f"{name}_0000_idx.bin").write_bytes(header + bytes(48 * len(cube)))


def quantised(cube: NDArray[np.complex128]) -> NDArray[np.complex64]:
    """In counts, as a converter gives it."""
    return (np.round(COUNTS * cube.real) + 1j * np.round(COUNTS * cube.imag)).astype(np.complex64)
