"""The front end as a description: powers, noise, patterns, polarisation, and the receiver's imperfections.

:mod:`shared.radar.receiver` applies the imperfections to a cube. All of them are off by default. Interference by other
radars is not simulated. It would be one more term of the cube in :func:`shared.radar.receiver.received`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Float64
from pydantic import Field, FiniteFloat

from shared.physics.units import db_to_power, dbm_to_watt, power_to_db
from shared.radar.antenna import IsotropicPattern, Pattern, car_radar_pattern
from shared.radar.validation import Described
from shared.radar.waveform import Waveform

Polarization = Literal["V", "H"]
"""Linear, of the electric field seen along boresight: V along z, H along y of the radar frame."""


class PhaseNoise(Described):
    """Phase noise of the one local oscillator that all TX and RX share.

    Its single-sideband level is flat within the bandwidth of its phase-locked loop and falls by 20 dB a decade beyond,

        L(f) = L_0 / (1 + (f / f_loop)^2)

    :param level_dbc_per_hz: L_0, single sideband at the transmitted frequency [dBc/Hz]
    :param loop_bandwidth_hz: f_loop [Hz]
    """

    level_dbc_per_hz: Annotated[FiniteFloat, Field(ge=-250, le=0)]
    loop_bandwidth_hz: Annotated[FiniteFloat, Field(gt=0)] = 300e3

    def density_per_hz(self, frequency_hz: Float[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
        """L(f), the two-sided spectral density of the phase [rad^2/Hz]."""
        return db_to_power(self.level_dbc_per_hz) / (1.0 + (frequency_hz / self.loop_bandwidth_hz) ** 2)

    def residual_rad(self, waveform: Waveform) -> float:
        """Standard deviation [rad] of the phase left on an echo from the end of the unambiguous range.

        The density times 4 sin^2(pi f tau), see :func:`shared.radar.receiver.with_phase_noise`, over both sidebands.
        """
        frequency = np.arange(1, waveform.samples) / waveform.chirp_duration_s
        farthest = waveform.samples / waveform.bandwidth_hz  # [s]
        residual = 4.0 * np.sin(np.pi * frequency * farthest) ** 2 * self.density_per_hz(frequency)  # [rad^2/Hz]
        return float(np.sqrt(2.0 * residual.sum() / waveform.chirp_duration_s))


class Converter(Described):
    """Analogue-to-digital conversion of the in-phase and the quadrature signal, each by itself.

    :param bits: resolution; the converter has 2^bits levels (24 at most: the significand of the stored samples)
    :param full_scale_dbm: power at the receiver's input of the complex tone whose in-phase and quadrature parts just
        reach the ends of the range [dBm], i.e. the gain before the converter is part of this number
    """

    bits: Annotated[int, Field(ge=1, le=24)]
    full_scale_dbm: FiniteFloat


class FrontEnd(Described):
    """Transmit power, noise figure, element patterns, polarisation and imperfections.

    :param transmit_power_dbm: power of one TX [dBm]
    :param noise_figure_db: receiver noise figure F [dB] at 290 K
    :param tx_pattern: pattern of every TX element
    :param rx_pattern: pattern of every RX element
    :param tx_polarization: "V" (vertical) or "H" (horizontal), of every TX
    :param rx_polarization: the same of every RX; unlike the TX's, the radar is cross-polarised
    :param phase_noise: of the local oscillator; None for none
    :param converter: None for ideal samples
    """

    transmit_power_dbm: Annotated[FiniteFloat, Field(ge=-200, le=200)] = 10.0
    noise_figure_db: Annotated[FiniteFloat, Field(ge=0, le=200)] = 12.0
    tx_pattern: Pattern = Field(default_factory=car_radar_pattern)
    rx_pattern: Pattern = Field(default_factory=car_radar_pattern)
    tx_polarization: Polarization = "V"
    rx_polarization: Polarization = "V"
    phase_noise: PhaseNoise | None = None
    converter: Converter | None = None

    @property
    def transmit_power_w(self) -> float:
        """Power of one TX [W]."""
        return dbm_to_watt(self.transmit_power_dbm)

    def with_boresight_gain(self) -> FrontEnd:
        """The front end with the gain of boresight in every direction."""
        ahead = np.array([1.0, 0.0, 0.0])

        def everywhere(pattern: Pattern) -> IsotropicPattern:
            return IsotropicPattern(gain_dbi=float(power_to_db(pattern.power_gain(ahead))))

        return self.model_copy(
            update={"tx_pattern": everywhere(self.tx_pattern), "rx_pattern": everywhere(self.rx_pattern)}
        )

    @property
    def cross_polarized(self) -> bool:
        return self.tx_polarization != self.rx_polarization
