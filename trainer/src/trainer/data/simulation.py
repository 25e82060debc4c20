"""Resting point targets in front of the radar: what the simulated experiments look at.

Eq. (1) and (2) of the paper, by :mod:`shared.signal`. A resting target has the same echo in every chirp, and the
Doppler spectrum is divided by its window's sum, so that the zero-Doppler cell of the frame is the range spectrum of
one chirp, with noise of power k T0 F f_s sum(w^2) / sum(w)^2 in each of its samples: one chirp stands for the frame,
exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal import if_signal
from shared.signal.imaging import DEFAULT_TERMS, near_field_images, sweep_moments
from shared.signal.spectrum import range_doppler
from shared.signal.windows import angle_window, cell_noise_power, hann

TRUTH_WINDOW = "taylor-30"
"""Of the virtual sensor's elements, the dataset factory's default."""

LEAST_BINS = 4
"""Angle bins that a lobe needs to have a width."""

CLOSE_UP_BINS = 7
"""Range bins shown on either side of a target."""


def in_plane(range_m: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """[K, 3] positions [m] at ranges [K] [m] and u [K] = sin(azimuth) in the plane z = 0."""
    return np.stack([range_m * np.sqrt(1.0 - u**2), range_m * u, np.zeros_like(u)], axis=-1)


def close_up(radar: Radar, range_m: float) -> tuple[NDArray[np.intp], int]:
    """(range bins around ``range_m``, the place of its own among them)."""
    row = round(range_m / radar.waveform.range_step_m)
    rows = np.arange(max(row - CLOSE_UP_BINS, 0), min(row + CLOSE_UP_BINS + 1, radar.waveform.range_bins))
    return rows, row - int(rows[0])


def out_of_sight(radar: Radar, range_m: float) -> str | None:
    """Why a target at ``range_m`` cannot be shown, None if it can."""
    if radar.grid.bins < LEAST_BINS:
        return f"{radar.grid.bins} angle bins show no target's lobe; {LEAST_BINS} do"
    farthest = (radar.waveform.range_bins - 1) * radar.waveform.range_step_m
    return f"the radar sees to {farthest:.1f} m, the targets stand at {range_m:g} m" if range_m > farthest else None


def snapshot(
    radar: Radar,
    positions_m: NDArray[np.float64],
    amplitudes: NDArray[np.complex128],
    generator: np.random.Generator | None,
) -> NDArray[np.complex64]:
    """[R, C] range-channel matrix of resting targets in the zero-Doppler cell [sqrt(W)].

    :param positions_m: [K, 3] radar frame
    :param amplitudes: [K] complex [sqrt(W)]
    :param generator: of the receiver noise; None for none
    """
    single = _one_chirp(radar)
    cube = if_signal(single, positions_m, np.zeros_like(positions_m), amplitudes)
    if generator is not None:
        window = hann(radar.waveform.chirps)
        power = radar.sample_noise_power_w * np.sum(window**2) / np.sum(window) ** 2
        noise = generator.standard_normal((*cube.shape, 2)) @ np.array([1.0, 1.0j])
        cube += np.sqrt(power / 2.0) * noise
    return range_doppler(cube.astype(np.complex64), single)[:, 0]


def truth_image(
    radar: Radar, positions_m: NDArray[np.float64], amplitudes: NDArray[np.complex128]
) -> NDArray[np.float32]:
    """[R, U] magnitude [sqrt(W)] that the virtual sensor sees of resting targets, noise free, as in the datasets."""
    sensor = radar.virtual_sensor
    virtual = _one_chirp(radar).model_copy(update={"array": sensor})
    fast_time = if_signal(virtual, positions_m, np.zeros_like(positions_m), amplitudes)[0]  # (N, C)
    moments = sweep_moments(fast_time * angle_window(TRUTH_WINDOW, sensor.channels), radar, DEFAULT_TERMS)
    return np.abs(near_field_images(moments[None].astype(np.complex64), radar, sensor)[0])


def amplitude_of(signal_to_noise_db: float, radar: Radar) -> float:
    """Amplitude [sqrt(W)] with this ratio of echo to noise power in one channel's range-Doppler cell [dB]."""
    return float(np.sqrt(cell_noise_power(radar) * 10.0 ** (signal_to_noise_db / 10.0)))


def _one_chirp(radar: Radar) -> Radar:
    waveform = radar.waveform.model_copy(update={"chirps": 1})
    return radar.model_copy(update={"waveform": waveform})
