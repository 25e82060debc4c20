"""Evaluation boards of Texas Instruments as presets: where their antennas stand, and how they radiate.

What was read. The cascade's elements (reference design TIDUEN5, Figures 5 to 7) stand on a grid of half a wavelength of
76.8 GHz (`TI_Cascade_Antenna_DesignFreq` in the MATLAB examples of mmWave Studio, whose `TI_Cascade_TX_position_azi`,
`..._ele` and `TI_Cascade_RX_position_azi` are the numbers below). The grid of the AWR2944EVM is `antGeometryCfg` of its
demo, 0.5 wavelengths across and 0.8 up.

What was not read, and is taken as the field knows it: the user's guides of the single-chip boards (IWR1443BOOST
SWRU518, xWR1642BOOST SWRU521, xWR1843BOOST SPRUIM4, AWR2944EVM SPRUJ22) and the devices' data sheets. From common use
are the elements of the BOOST boards, half a wavelength and two wavelengths apart, the gain of 10.5 dBi with 3 dB widths
of 56 degrees in azimuth and 28 in elevation, transmit powers and noise figures. Levels depend on these. Angles depend
on the elements alone; a public capture of 2 x 4 of them has its stated angles.

What nothing says, and is taken here:

- The wavelength of the single-chip boards' grid: that of :data:`DESIGN_HZ`. A wavelength 1 % off scales u by 1 %.
- How the group of TX stands to the group of RX: both are centred on the radar's origin. At a range R an offset d of the
  group turns what is seen by about d / (2 R) rad, 0.06 degrees for 20 mm at 10 m.
- Towards which side the numbers run. y falls with the number here: under that sign the echoes of the public captures of
  OpenRadar (8 channels) and of a cascade (86 elements) have the angles that are stated beside them. A radar file with
  ``mirror = true`` turns the board round.
- Whether an elevated TX stands above or below: above. Channels of elevated TX are no part of the azimuth line
  (:attr:`shared.radar.arrays.AntennaArray.azimuth_channels`).
- The patterns of the AWR2944EVM and of the cascade: those of the BOOST boards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from shared.physics.units import SPEED_OF_LIGHT
from shared.radar.antenna import ParabolicPattern
from shared.radar.arrays import AntennaArray, Position
from shared.radar.front_end import FrontEnd
from shared.radar.profile import ChirpProfile

DESIGN_HZ = 77e9
"""Of the single-chip boards: the start of their band."""
CASCADE_DESIGN_HZ = 76.8e9
BOOST_PATTERN = ParabolicPattern(gain_dbi=10.5, azimuth_beamwidth_deg=56.0, elevation_beamwidth_deg=28.0)


@dataclass(frozen=True)
class Board:
    """A board as it leaves the factory.

    :param array: of all its elements, TX and RX in the order of their numbers
    :param profile: chirps to simulate where none are stated
    """

    array: AntennaArray
    front_end: FrontEnd
    profile: ChirpProfile


CASCADE_TX = (11, 10, 9, 32, 28, 24, 20, 16, 12, 8, 4, 0)
CASCADE_TX_UP = (6, 4, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0)
CASCADE_RX = (11, 12, 13, 14, 50, 51, 52, 53, 46, 47, 48, 49, 0, 1, 2, 3)
"""In half wavelengths: TX1 to TX3 and RX1 to RX4 are the master's, then those of slaves 1, 2 and 3."""


def mmwcas() -> Board:
    """MMWCAS-RF-EVM, four AWR2243 in cascade: 12 TX, 16 RX (TIDUEN5, Figures 5 to 7).

    TX4 to TX12 stand on the line of the RX and form 86 different elements at half a wavelength with them, of 144
    channels; TX1 to TX3 stand 6, 4 and 1 half wavelengths above it.
    """
    array = _array(CASCADE_TX, CASCADE_RX, CASCADE_TX_UP, CASCADE_DESIGN_HZ)
    return _board(array, chirps=64, transmit_power_dbm=13.0, noise_figure_db=13.0)


FOUR_RX = (0, 1, 2, 3)


def _three_by_four() -> AntennaArray:
    """TX1 and TX3 two wavelengths apart, TX2 midway between them, half a wavelength higher: 8 elements on the line."""
    return _array((0, 2, 4), FOUR_RX, tx_up=(0, 1, 0))


BOARDS: dict[str, Callable[[], Board]] = {
    # IWR1443BOOST, AWR1443BOOST
    "iwr1443": lambda: _board(_three_by_four(), transmit_power_dbm=12.0, noise_figure_db=16.0),
    # IWR1642BOOST, AWR1642BOOST: 2 TX two wavelengths apart, 8 elements
    "iwr1642": lambda: _board(_array((0, 4), FOUR_RX), transmit_power_dbm=12.5, noise_figure_db=15.0),
    # IWR1843BOOST, AWR1843BOOST
    "iwr1843": lambda: _board(_three_by_four(), transmit_power_dbm=12.0, noise_figure_db=15.0),
    # AWR2944EVM (``antGeometryCfg`` of the demo), whose converter samples real signals: TX1, TX3 and TX4 stand at 0, 2
    # and 4 wavelengths, TX2 at one, 0.8 wavelengths off the line; twelve elements along it.
    "awr2944": lambda: _board(
        _array((0, 2, 4, 8), FOUR_RX, tx_up=(0, 1.6, 0, 0)), real=True, transmit_power_dbm=12.0, noise_figure_db=13.0
    ),
    "mmwcas": mmwcas,
    # The cascade without its elevated TX: TX12 first and TX4 last, as TI's scripts let them send; 86 elements
    "mmwcas-azimuth": lambda: _board(
        _array(CASCADE_TX[:2:-1], CASCADE_RX, design_hz=CASCADE_DESIGN_HZ),
        chirps=64, transmit_power_dbm=13.0, noise_figure_db=13.0,
    ),
}  # fmt: skip
"""By the names that ``--radar`` and ``--board`` take."""


def mirrored(array: AntennaArray) -> AntennaArray:
    """The array with left and right exchanged."""

    def turned(positions: tuple[Position, ...]) -> tuple[Position, ...]:
        return tuple((x, -y, z) for x, y, z in positions)

    return AntennaArray(tx_m=turned(array.tx_m), rx_m=turned(array.rx_m))


def _board(array: AntennaArray, chirps: int = 128, real: bool = False, **front_end: float) -> Board:
    """With a sampled sweep of 1.02 GHz in 51 us, which every one of these devices can send."""
    profile = ChirpProfile(
        start_frequency_hz=77e9, slope_hz_per_s=20e12, idle_time_s=7e-6, adc_start_time_s=6e-6, ramp_end_time_s=60e-6,
        samples=256, sample_rate_hz=5e6, chirps=chirps, real=real,
    )  # fmt: skip
    described = FrontEnd.model_validate({"tx_pattern": BOOST_PATTERN, "rx_pattern": BOOST_PATTERN, **front_end})
    return Board(array, described, profile)


def _array(
    tx: Sequence[float], rx: Sequence[float], tx_up: Sequence[float] | None = None, design_hz: float = DESIGN_HZ
) -> AntennaArray:
    """Elements at these multiples of half a wavelength towards the right, and up, TX and RX centred on the origin.

    TX are centred by those on the line of the RX.
    """
    grid = SPEED_OF_LIGHT / (2.0 * design_hz)
    up = np.zeros(len(tx)) if tx_up is None else np.array(tx_up, dtype=np.float64)
    tx_left, rx_left = -np.array(tx, dtype=np.float64), -np.array(rx, dtype=np.float64)
    tx_left, rx_left = tx_left - tx_left[up == 0.0].mean(), rx_left - rx_left.mean()

    def positions(left: np.ndarray, height: np.ndarray) -> tuple[Position, ...]:
        return tuple((0.0, float(y), float(z)) for y, z in zip(grid * left, grid * height, strict=True))

    return AntennaArray(tx_m=positions(tx_left, up), rx_m=positions(rx_left, np.zeros(len(rx))))
