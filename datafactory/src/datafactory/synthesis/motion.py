"""How a path's delay moves within the frame, developed around mid-frame, and what the line kernel leaves out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from datafactory.paths.table import ScatteredPaths
from datafactory.synthesis.wave_model import WaveModel
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz

NU_RMS = 12.0**-0.5
"""Root mean square of nu over the sweep, of eta over the frame."""
SQUARE_RMS = 80.0**-0.5
"""... of their squares,"""
FOURTH_RMS = 2304.0**-0.5
"""... of their fourth powers."""
FOURTH_ROOT = 80.0**-0.25
"""Fourth root of the mean of eta^4,"""
CENTRED_FOURTH_ROOT = (1.0 / 2304.0 - 1.0 / 1344.0 + 1.0 / 1920.0 - 1.0 / 5184.0 + 1.0 / 20736.0) ** 0.25
"""... of that of (eta^2 - 1/12)^4."""


@dataclass(frozen=True)
class Leg:
    """One leg of paths at one instant, seen from a centre.

    :param rate: of its length [m/s]
    :param bend: second derivative of its length [m/s^2]
    :param jerk: third derivative [m/s^3]
    :param length: [m]; ``speed`` [m/s]
    """

    length: Float64[np.ndarray, " paths"]
    rate: Float64[np.ndarray, " paths"]
    bend: Float64[np.ndarray, " paths"]
    jerk: Float64[np.ndarray, " paths"]
    speed: Float64[np.ndarray, " paths"]


@dataclass(frozen=True)
class Motion:
    """Paths around mid-frame, in cycles: f eta + q eta^2 + ..., and the bend
    e(eta) = e_1 eta + e_2 (eta^2 - 1/12) + e_3 eta^3.

    :param doppler: f, at the frequency that the line kernel gives a path
    :param curvature: q
    :param bend: [3, K] e_1, e_2, e_3 of :mod:`datafactory.synthesis.lines`
    """

    doppler: Float64[np.ndarray, " paths"]
    curvature: Float64[np.ndarray, " paths"]
    bend: Float64[np.ndarray, "3 paths"]


def leg_of(
    point: Float64[np.ndarray, "paths 3"], velocity: Float64[np.ndarray, "paths 3"], time_s: float,
    centre: Float64[np.ndarray, " 3"],
) -> Leg:  # fmt: skip
    """The leg between a centre and points [m] that move evenly [m/s]: r'' = (v^2 - r'^2) / r, r''' = -3 r' r'' / r."""
    vector = point + velocity * time_s - centre
    length = np.maximum(np.linalg.norm(vector, axis=1), 1e-9)
    rate = np.einsum("ki,ki->k", vector, velocity) / length
    speed = np.linalg.norm(velocity, axis=1)
    bend = np.maximum(speed**2 - rate**2, 0.0) / length
    return Leg(length, rate, bend, -3.0 * rate * bend / length, speed)


def coupling(radar: Radar, model: WaveModel) -> float:
    """kappa = B / f_0 of the lines; 0 where ranges do not migrate."""
    return radar.waveform.bandwidth_hz / reference_frequency_hz(radar) if model.range_migration else 0.0


def motion_of(
    paths: ScatteredPaths,
    tx_centre: Float64[np.ndarray, " 3"],
    rx_centre: Float64[np.ndarray, " 3"],
    start_s: float,
    radar: Radar,
    model: WaveModel,
) -> Motion:
    """Motion of paths seen from two centres.

    :param start_s: start of the chirp at mid-frame [s]
    """
    waveform, kappa = radar.waveform, coupling(radar, model)
    frame_s = waveform.chirps * waveform.chirp_interval_s
    time, lead = model.phase_time_s(start_s, radar), model.lead_s(radar)
    tx = leg_of(paths.tx_point, paths.tx_velocity, time, tx_centre)
    rx = leg_of(paths.rx_point, paths.rx_velocity, time, rx_centre)
    cycles = reference_frequency_hz(radar) / SPEED_OF_LIGHT * frame_s
    full = cycles * (tx.rate + rx.rate + paths.between_rate_mps)
    curvature = 0.5 * cycles * frame_s * (tx.bend + rx.bend)
    slower = 1.0
    if waveform.residual_video_phase:
        delay = (tx.length + rx.length + paths.between_m + paths.between_rate_mps * time) / SPEED_OF_LIGHT
        slower = 1.0 - waveform.slope_hz_per_s * delay / reference_frequency_hz(radar)
    doppler = full * slower
    cubic = cycles * frame_s**2 / 6.0 * (tx.jerk + rx.jerk)
    # The range is that of a later time where the sensor moves within the chirp.
    later, later_curvature, later_cubic = full, curvature, cubic
    if lead:
        tx = leg_of(paths.tx_point, paths.tx_velocity, time + lead, tx_centre)
        rx = leg_of(paths.rx_point, paths.rx_velocity, time + lead, rx_centre)
        later = cycles * (tx.rate + rx.rate + paths.between_rate_mps)
        later_curvature = 0.5 * cycles * frame_s * (tx.bend + rx.bend)
        later_cubic = cycles * frame_s**2 / 6.0 * (tx.jerk + rx.jerk)
    # e = X - x - kappa f_l eta - kappa eta s': of the term c_k eta^k in s and of d_k eta^k in X the part d_k - k c_k.
    bend = kappa * np.stack([later - doppler, later_curvature - 2.0 * curvature, later_cubic - 3.0 * cubic])
    return Motion(doppler, curvature * slower, bend)


def moving(paths: ScatteredPaths) -> Bool[np.ndarray, " paths"]:
    """Whether a path's delay changes."""
    return np.any(paths.tx_velocity, axis=1) | np.any(paths.rx_velocity, axis=1) | (paths.between_rate_mps != 0.0)


def left_out(
    paths: ScatteredPaths,
    motion: Motion,
    reaches_m: tuple[float, float],
    centres: tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]],
    start_s: float,
    radar: Radar,
    model: WaveModel,
) -> tuple[Float64[np.ndarray, " paths"], Float64[np.ndarray, " paths"]]:
    """What the line kernel must reach and what it leaves out.

    :param reaches_m: of TX and RX about their centres [m]
    :returns: the frequency that a path has beyond its own, by curvature and the elements' different views [cycles a
        frame], infinite where an element is reached within the frame; and a bound on the relative root mean square
        error over sweep and frame
    """
    waveform, kappa = radar.waveform, coupling(radar, model)
    frame_s = waveform.chirps * waveform.chirp_interval_s
    lead = model.lead_s(radar)
    time = model.phase_time_s(start_s, radar)
    cycles = reference_frequency_hz(radar) / SPEED_OF_LIGHT * frame_s
    view, bends, fourth = (np.zeros(len(paths)) for _ in range(3))
    ends = (paths.tx_point, paths.tx_velocity), (paths.rx_point, paths.rx_velocity)
    for (point, velocity), reach, centre in zip(ends, reaches_m, centres, strict=True):
        leg = leg_of(point, velocity, time, centre)
        # Nowhere in the frame is an element nearer than this.
        nearest = leg.length - reach - leg.speed * (0.51 * frame_s + lead)
        across = leg.bend * leg.length
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(nearest > 0.0, reach / nearest, np.inf)
            # Between elements r' differs by v_across a / r, r'' by at most 2 / sqrt(3) v^2 a / r^2. The fourth
            # derivative is at most 15 v^2 v_across^2 / r^3.
            terms = (
                cycles * (np.sqrt(across) * part + 1.5 * leg.speed * part**2),
                cycles * 0.5 * frame_s * 1.155 * leg.speed**2 * part / nearest,
                cycles * frame_s**3 / 24.0 * 15.0 * leg.speed**2 * across / nearest**3,
            )
        for total, term in zip((view, bends, fourth), terms, strict=True):
            total += np.where(leg.speed > 0.0, np.where(nearest > 0.0, term, np.inf), 0.0)
    linear, square, cubic = np.abs(motion.bend)
    curvature = np.abs(motion.curvature)
    # The second order of exp(j 2 pi nu e), e_3 at its largest, and that of s((1 + nu kappa) eta).
    size = FOURTH_ROOT * (linear + 0.25 * cubic) + CENTRED_FOURTH_ROOT * square
    error = 2.0 * np.pi**2 * SQUARE_RMS * size**2 + 2.0 * np.pi * kappa**2 * SQUARE_RMS**2 * curvature
    # What e lacks: its fourth power, and what other elements see.
    lacking = 3.0 * FOURTH_RMS * fourth + SQUARE_RMS * bends
    if lead:
        lacking = lacking + NU_RMS * 2.0 * bends * lead / frame_s + 4.0 * NU_RMS * fourth * (lead / frame_s) ** 3
    error += 2.0 * np.pi * NU_RMS * kappa * lacking
    slope = 0.75 * cubic / (2.0 * kappa) if kappa else np.zeros(len(paths))
    return view + 1.02 * curvature + slope, error
