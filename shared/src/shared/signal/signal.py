"""The IF signal of point targets, eq. (1) and (2) of the paper, written as it stands: slow and obviously right.

    s(i_tx, i_rx, t) = sum_k A_k exp(+j 2 pi (mu t tau_k + f_c tau_k))                                          (1)
    tau_k(i_tx, i_rx) = (|x_tx - x_k| + |x_rx - x_k|) / c                                                      (2)

Everything fast in this project is tested against this sum. The delay is frozen at the start of each chirp. The sum
costs targets * channels * chirps * samples complex exponentials: it is a reference, and makes the experiments' few
targets in one chirp, but no datasets.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex128, Float, Float64, Inexact, Real
from numpy.typing import ArrayLike

from shared.physics.units import SPEED_OF_LIGHT, db_to_power
from shared.radar import Radar

Cube = Complex128[np.ndarray, "chirps samples channels"]


def chirp_times(radar: Radar) -> Float64[np.ndarray, "tx chirps"]:
    """[TX, chirps] start of each chirp of each TX [s] after the start of chirp 0."""
    waveform, tx_count = radar.waveform, len(radar.array.tx_m)
    start = waveform.chirp_interval_s * np.arange(waveform.chirps)
    turn = waveform.chirp_interval_s / tx_count if waveform.multiplexing == "tdm" else 0.0
    return start[None, :] + turn * np.arange(tx_count)[:, None]


def round_trip_delays(
    radar: Radar, position: Float[np.ndarray, " 3"], velocity: Float[np.ndarray, " 3"]
) -> Float64[np.ndarray, "channels chirps"]:
    """[channels, chirps] delay of eq. (2) [s] of one target at ``position`` [3] m + ``velocity`` [3] m/s * t."""
    array = radar.array
    times = chirp_times(radar)[array.channel_tx]  # (C, M)
    target = position + velocity * times[..., None]  # (C, M, 3)
    tx_leg = np.linalg.norm(target - array.tx[array.channel_tx][:, None], axis=-1)
    rx_leg = np.linalg.norm(target - array.rx[array.channel_rx][:, None], axis=-1)
    return (tx_leg + rx_leg) / SPEED_OF_LIGHT


def if_signal_of_delays(radar: Radar, delays_s: Float64[np.ndarray, "channels chirps"]) -> Cube:
    """[chirps, samples, channels] IF signal of one echo of unit amplitude with these delays [channels, chirps]."""
    waveform = radar.waveform
    t = waveform.chirp_duration_s * np.arange(waveform.samples) / waveform.samples
    tau = delays_s.T[:, None, :]  # (M, 1, C)
    mu = waveform.slope_hz_per_s
    cycles = mu * t[None, :, None] * tau + waveform.carrier_hz * tau
    if waveform.residual_video_phase:
        cycles = cycles - mu * tau**2 / 2.0
    return np.exp(2j * np.pi * cycles)


def if_signal(
    radar: Radar,
    positions: Float[np.ndarray, "targets 3"],
    velocities: Float[np.ndarray, "targets 3"],
    amplitudes: Inexact[np.ndarray, " targets"],
) -> Cube:
    """[chirps, samples, channels] cube of point targets, eq. (1).

    :param positions: [K, 3] at t = 0, radar frame [m]
    :param velocities: [K, 3] relative to the radar [m/s]
    :param amplitudes: [K] real or complex [sqrt(W)]
    """
    waveform = radar.waveform
    cube = np.zeros((waveform.chirps, waveform.samples, radar.array.channels), dtype=np.complex128)
    for position, velocity, amplitude in zip(positions, velocities, amplitudes, strict=True):
        cube += amplitude * if_signal_of_delays(radar, round_trip_delays(radar, position, velocity))
    return cube


def target_amplitudes(
    radar: Radar,
    positions: Float[np.ndarray, "targets 3"],
    rcs_dbsm: Real[np.ndarray, " targets"],
    phase_rad: Real[np.ndarray, " targets"],
) -> Complex128[np.ndarray, " targets"]:
    """[K] amplitudes [sqrt(W)] by the radar equation, one number for all channels, seen from the origin at t = 0.

    A = sqrt(P_t G_t G_r lambda^2 sigma / ((4 pi)^3 R^4)) exp(j phase), lambda at mid-sweep (Skolnik, Introduction to
    Radar Systems, eq. 1.7). Valid in the far field of the target, R > 2 D^2 / lambda.

    :param positions: [K, 3] radar frame [m], none at the origin
    :param rcs_dbsm: [K] radar cross sections [dBsm]
    :param phase_rad: [K] phases [rad]
    """
    front_end, wavelength = radar.front_end, radar.waveform.wavelength_m
    range_m = np.linalg.norm(positions, axis=-1)
    gains = front_end.tx_pattern.power_gain(positions) * front_end.rx_pattern.power_gain(positions)
    power = front_end.transmit_power_w * gains * wavelength**2 * db_to_power(rcs_dbsm)
    power /= (4.0 * np.pi) ** 3 * range_m**4
    return np.sqrt(power) * np.exp(1j * np.asarray(phase_rad))


def manifold(
    positions_m: Float[np.ndarray, " channels"], wavelength_m: float, u: ArrayLike
) -> Complex128[np.ndarray, "channels ..."]:
    """[C, *u.shape] a(u) = exp(-j k u p), plane waves of unit amplitude from the directions u = sin(azimuth).

    By eq. (1) and (2) an echo from u has this phase over the virtual elements, k = 2 pi / lambda of mid-sweep. Who
    looks for it multiplies by the conjugate, so that images peak at +u: one sign and one wavelength for all who image
    or estimate. Valid from about 5 m for the input array of 94 mm: nearer than that the wave front is curved.

    :param positions_m: [C] y_tx + y_rx of each virtual element [m]
    :param wavelength_m: at mid-sweep [m]
    """
    wavenumber = 2.0 * np.pi / wavelength_m
    return np.exp(-1j * wavenumber * np.multiply.outer(positions_m, np.asarray(u, dtype=np.float64)))
