"""Paths at mid-frame, as the virtual sensor sees them: where the truth develops the delay.

Of a leg l and its derivatives (:func:`datafactory.synthesis.motion.leg_of`), with f_0 the reference frequency and T
the frame, the Doppler is f_0 T l' / c bins and the curvature f_0 T^2 l'' / (2 c) cycles. The third derivative is left
out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from datafactory.paths.table import ScatteredPaths
from datafactory.synthesis.doppler_moments import BLOCK
from datafactory.synthesis.motion import instants, leg_of
from shared.physics.units import SPEED_OF_LIGHT
from shared.physics.vectors import lengths, taken
from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz


@dataclass(frozen=True)
class MidFrame:
    """Paths at mid-frame, as seen by one TX: the input of the kernel.

    :param rx_point: [m]; ``rx_velocity`` [m/s]
    :param tx_length, tx_rate: length before the RX leg [m] and its rate [m/s]
    :param curvature: q [cycles], seen from the array's centre
    :param doppler: f [bins], unwrapped, seen from the array's centre
    :param range_bins: x = B tau seen from the array's centre, at the time of the beat frequency
    :param amplitude: [sqrt(W)]
    :param departure: largest distance of an element's Doppler from the point of expansion, with migration [bins]
    """

    rx_point: Float64[np.ndarray, "paths 3"]
    rx_velocity: Float64[np.ndarray, "paths 3"]
    tx_length: Float64[np.ndarray, " paths"]
    tx_rate: Float64[np.ndarray, " paths"]
    curvature: Float64[np.ndarray, " paths"]
    doppler: Float64[np.ndarray, " paths"]
    range_bins: Float64[np.ndarray, " paths"]
    amplitude: Complex128[np.ndarray, " paths"]
    departure: Float64[np.ndarray, " paths"]

    def take(self, index: Int64[np.ndarray, " chosen"]) -> MidFrame:
        """The paths at these indices."""
        return MidFrame(**{name: taken(getattr(self, name), index) for name in self.__dataclass_fields__})


def at_mid_frame(
    paths: ScatteredPaths,
    radar: Radar,
    tx: Float64[np.ndarray, " 3"],
    centre: Float64[np.ndarray, " 3"],
    intra_chirp: bool,
) -> MidFrame:
    """Paths at mid-frame.

    :param tx: [3] the virtual sensor's only TX; :param centre: [3] of its RX [m]
    :param intra_chirp: motion within the chirp
    """
    waveform = radar.waveform
    after, lead = instants(radar, intra_chirp)
    time = waveform.chirps // 2 * waveform.chirp_interval_s + after
    frame_s = waveform.chirps * waveform.chirp_interval_s
    rx_point = paths.rx_point + paths.rx_velocity * time
    tx_leg = leg_of(paths.tx_point, paths.tx_velocity, time, tx)
    rx_leg = leg_of(paths.rx_point, paths.rx_velocity, time, centre)
    tx_length = tx_leg.length + paths.between_m + paths.between_rate_mps * time
    tx_rate = tx_leg.rate + paths.between_rate_mps
    cycles_per_metre = reference_frequency_hz(radar) / SPEED_OF_LIGHT
    doppler = cycles_per_metre * (tx_rate + rx_leg.rate) * frame_s
    return MidFrame(
        rx_point=rx_point,
        rx_velocity=paths.rx_velocity,
        tx_length=tx_length,
        tx_rate=tx_rate,
        curvature=0.5 * cycles_per_metre * (tx_leg.bend + rx_leg.bend) * frame_s**2,
        doppler=doppler,
        range_bins=waveform.bandwidth_hz
        / SPEED_OF_LIGHT
        * (tx_length + rx_leg.length + lead * (tx_rate + rx_leg.rate)),
        amplitude=paths.amplitude,
        departure=_departure(rx_point, paths.rx_velocity, doppler, radar, frame_s),
    )


def _departure(
    rx_point: Float64[np.ndarray, "paths 3"],
    rx_velocity: Float64[np.ndarray, "paths 3"],
    doppler: Float64[np.ndarray, " paths"],
    radar: Radar,
    frame_s: float,
) -> Float64[np.ndarray, " paths"]:
    """Largest distance of an element's Doppler from its block's, and the Doppler that migration adds [bins]."""
    distance = np.maximum(lengths(rx_point), 0.5)
    speed = lengths(rx_velocity)
    half_block = 0.5 * BLOCK * SPEED_OF_LIGHT / (2.0 * radar.waveform.carrier_hz)
    spread = reference_frequency_hz(radar) / SPEED_OF_LIGHT * speed * half_block / distance * frame_s
    # Hann gives the sweep's ends no weight: its standard deviation of nu is 0.18, and twice that holds 96 % of the
    # weight.
    return spread + 0.36 * np.abs(doppler) * radar.waveform.bandwidth_hz / reference_frequency_hz(radar)
