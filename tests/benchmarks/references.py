"""The references that ours is held against, in float64 on one thread."""

from __future__ import annotations

import importlib
import time
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from record import NotInstalledError

from datafactory.paths.table import PathTable
from shared.physics.cycles import phasor
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.imaging import pixel_delays
from shared.signal.windows import hann

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

DIRECT_CHUNK = 64
"""Paths summed at once: 1024 samples of them fit the second cache."""
OVERSAMPLING = 8
"""Of the range profiles in the back projection, which interpolates them linearly."""


def load_finufft() -> Any:
    """FINUFFT's module.

    :raises NotInstalledError: it is a benchmark extra
    """
    try:
        return importlib.import_module("finufft")
    except ImportError as error:
        raise NotInstalledError(f"FINUFFT cannot be imported ({error}): pip install finufft") from None


def delays(paths: PathTable, array: AntennaArray, channel: int, time_s: float) -> Real:
    """[K] delays [s] of scattered paths for one channel at one instant: |x_i - p| + b + |x_j - q|, over c."""
    scattered = paths.scattered
    tx, rx = array.tx[array.channel_tx[channel]], array.rx[array.channel_rx[channel]]
    tx_leg = np.linalg.norm(scattered.tx_point + scattered.tx_velocity * time_s - tx, axis=1)
    rx_leg = np.linalg.norm(scattered.rx_point + scattered.rx_velocity * time_s - rx, axis=1)
    return (tx_leg + scattered.between_m + scattered.between_rate_mps * time_s + rx_leg) / SPEED_OF_LIGHT


def direct_sum(paths: PathTable, radar: Radar, array: AntennaArray, channel: int, chirp: int) -> Complex:
    """[samples] eq. (1) summed in float64 for one channel and chirp, in NumPy, some paths at a time."""
    waveform = radar.waveform
    tau = delays(paths, array, channel, chirp * waveform.chirp_interval_s)
    frequency = waveform.carrier_hz + waveform.bandwidth_hz * np.arange(waveform.samples) / waveform.samples
    amplitude = paths.scattered.amplitude
    signal = np.zeros(waveform.samples, dtype=np.complex128)
    for first in range(0, len(tau), DIRECT_CHUNK):
        chunk = slice(first, first + DIRECT_CHUNK)
        cycles = frequency[:, None] * tau[chunk]
        signal += np.exp(2j * np.pi * (cycles - np.rint(cycles))) @ amplitude[chunk]
    return signal


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _nufft_inputs(
    tx_point, rx_point, tx_velocity, rx_velocity, between, between_rate, amplitude,
    tx, rx, time_s, cycles_per_metre, turns_per_metre, position, strength,
):  # fmt: skip
    """Fill ``position`` [K] rad and ``strength`` [K] of a type 1 transform, at the speed of our own kernels."""
    for k in range(len(position)):
        tx_square, rx_square = 0.0, 0.0
        for axis in range(3):
            tx_square += (tx_point[k, axis] + tx_velocity[k, axis] * time_s - tx[axis]) ** 2
            rx_square += (rx_point[k, axis] + rx_velocity[k, axis] * time_s - rx[axis]) ** 2
        path = np.sqrt(tx_square) + between[k] + between_rate[k] * time_s + np.sqrt(rx_square)
        cosine, sine = phasor(cycles_per_metre * path)
        strength[k] = amplitude[k] * complex(cosine, sine)
        turns = turns_per_metre * path
        position[k] = 2.0 * np.pi * (turns - np.floor(turns + 0.5))


def nufft_sum(
    paths: PathTable, radar: Radar, array: AntennaArray, channel: int, chirp: int, tolerance: float
) -> tuple[Complex, float]:
    """[samples] the same sum by one 1D type 1 FINUFFT on one thread, and processor seconds of the transform alone."""
    waveform, scattered = radar.waveform, paths.scattered
    finufft = load_finufft()
    # Mode k of the transform is sample n = k + N // 2.
    middle = waveform.carrier_hz + waveform.bandwidth_hz * (waveform.samples // 2) / waveform.samples
    position, strength = np.empty(len(scattered)), np.empty(len(scattered), dtype=np.complex128)
    _nufft_inputs(
        scattered.tx_point, scattered.rx_point, scattered.tx_velocity, scattered.rx_velocity,
        scattered.between_m, scattered.between_rate_mps, scattered.amplitude,
        array.tx[array.channel_tx[channel]], array.rx[array.channel_rx[channel]], chirp * waveform.chirp_interval_s,
        middle / SPEED_OF_LIGHT, waveform.bandwidth_hz / waveform.samples / SPEED_OF_LIGHT, position, strength,
    )  # fmt: skip
    start = time.process_time()
    signal = finufft.nufft1d1(position, strength, waveform.samples, eps=tolerance, isign=1, nthreads=1)
    return signal, time.process_time() - start


def nufft_image(fast_time: Complex, radar: Radar, array: AntennaArray, rows: NDArray[np.intp]) -> Complex:
    """[rows, U] exact matched filter by one 1D type 2 FINUFFT a channel, 1e-12, one thread.

    The same sum as :func:`shared.signal.imaging.matched_filter_row`, all rows at once.

    :param fast_time: [samples, C]
    """
    waveform = radar.waveform
    finufft = load_finufft()
    window = hann(waveform.samples)
    weighted = fast_time * (window / window.sum())[:, None]
    tau = np.stack([pixel_delays(radar, array, row * waveform.range_step_m) for row in rows])  # (rows, C, U)
    middle = waveform.carrier_hz + waveform.bandwidth_hz * (waveform.samples // 2) / waveform.samples
    image = np.zeros((len(rows), radar.grid.bins), dtype=np.complex128)
    for channel in range(array.channels):
        delay = np.ascontiguousarray(tau[:, channel]).ravel()
        position = 2.0 * np.pi * ((waveform.bandwidth_hz / waveform.samples * delay) % 1.0)
        modes = np.ascontiguousarray(weighted[:, channel])
        values = finufft.nufft1d2(position, modes, eps=1e-12, isign=-1, nthreads=1)
        image += (values * np.exp(-2j * np.pi * ((middle * delay) % 1.0))).reshape(image.shape)
    return image / array.channels


def back_projection(fast_time: Complex, radar: Radar, array: AntennaArray) -> Complex:
    """[R, U] back projection in NumPy: range profiles 8 times oversampled, interpolated linearly, phase compensated.

    :param fast_time: [samples, C]
    """
    waveform = radar.waveform
    window = hann(waveform.samples)
    length = OVERSAMPLING * waveform.samples
    rolled = np.zeros((length, array.channels), dtype=np.complex128)
    order = np.arange(waveform.samples) - waveform.samples // 2  # mid-sweep first, so that profiles vary slowly
    rolled[order] = fast_time * (window / window.sum())[:, None]
    profiles = np.fft.fft(rolled, axis=0)
    middle = waveform.carrier_hz + waveform.bandwidth_hz * (waveform.samples // 2) / waveform.samples
    tau = np.stack([pixel_delays(radar, array, range_m) for range_m in waveform.ranges_m])  # (R, C, U)
    image = np.zeros((waveform.range_bins, radar.grid.bins), dtype=np.complex128)
    for channel in range(array.channels):
        delay = tau[:, channel]
        position = OVERSAMPLING * waveform.bandwidth_hz * delay
        cell = np.floor(position).astype(np.intp)
        fraction = position - cell
        profile = profiles[:, channel]
        value = (1.0 - fraction) * profile[cell % length] + fraction * profile[(cell + 1) % length]
        image += value * np.exp(-2j * np.pi * ((middle * delay) % 1.0))
    return image / array.channels
