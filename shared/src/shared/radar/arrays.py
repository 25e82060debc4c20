"""Antenna arrays: where the elements stand, and which virtual elements they form.

Radar frame: x forward (boresight), y left, z up, metres (ISO 8855). The origin is the centroid of the full array's RX
elements, because with few TX close together that is the point from which the angle of an echo is seen; a thinned array
keeps the full array's origin, so that images of all arrays register.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from jaxtyping import Float, Float64, Int
from pydantic import Field, FiniteFloat, model_validator

from shared.physics.errors import Told
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar.validation import Described

Position = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

AVR_QDM_110_THINNED_RX = {"full": tuple(range(16)), "sparse6": (0, 1, 6, 10, 13, 15), "sparse4": (0, 1, 10, 15)}
"""RX elements kept by the paper's arrays (its Fig. 4 and published code), by array name."""

COINCIDENT_WAVELENGTHS = 0.01
"""Virtual elements nearer than that to each other are one place: at most 3.6 degrees of phase."""

LEVEL_M = 1e-4
"""Elements within that height of each other are at the same: 0.04 rad of phase at 77 GHz, 10 degrees up."""

MOST_CHANNELS = 2**14
"""Some eight times the largest imaging radars."""


class AntennaArray(Told, Described):
    """A MIMO array of TX and RX phase centres.

    :param tx_m: TX positions in the radar frame [m]
    :param rx_m: RX positions in the radar frame [m]
    """

    tx_m: Annotated[tuple[Position, ...], Field(min_length=1)]
    rx_m: Annotated[tuple[Position, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _within_a_metre(self) -> AntennaArray:
        if self.channels > MOST_CHANNELS:
            raise ValueError(
                f"{len(self.tx_m)} TX and {len(self.rx_m)} RX make {self.channels} channels; expected at most "
                f"{MOST_CHANNELS}"
            )
        reach = max(np.abs(self.tx).max(), np.abs(self.rx).max())
        if reach > 1.0:
            raise ValueError(f"array positions reach {reach:g} m from the origin; expected metres, at most 1 m")
        return self

    def __str__(self) -> str:
        _, wide, high = 1e3 * np.ptp(self.virtual, axis=0)
        return (
            f"{len(self.tx_m)} TX x {len(self.rx_m)} RX, {self.channels} virtual channels, "
            f"{wide:.0f} mm wide, {high:.0f} mm high"
        )

    @property
    def tx(self) -> Float64[np.ndarray, "tx 3"]:
        """[TX, 3] positions [m]."""
        return np.array(self.tx_m, dtype=np.float64)

    @property
    def rx(self) -> Float64[np.ndarray, "rx 3"]:
        """[RX, 3] positions [m]."""
        return np.array(self.rx_m, dtype=np.float64)

    @property
    def channels(self) -> int:
        """Number of virtual elements, TX times RX."""
        return len(self.tx_m) * len(self.rx_m)

    @property
    def channel_tx(self) -> Int[np.ndarray, " channels"]:
        """[channels] TX index of each virtual element; rx-major order, index = TX count * rx + tx."""
        return np.tile(np.arange(len(self.tx_m)), len(self.rx_m))

    @property
    def channel_rx(self) -> Int[np.ndarray, " channels"]:
        """[channels] RX index of each virtual element, see :attr:`channel_tx`."""
        return np.repeat(np.arange(len(self.rx_m)), len(self.tx_m))

    @property
    def virtual(self) -> Float64[np.ndarray, "channels 3"]:
        """[channels, 3] sums of TX and RX position [m]: in the far field the echo's path is 2 R - u . (tx + rx)."""
        return self.tx[self.channel_tx] + self.rx[self.channel_rx]

    @property
    def azimuth_channels(self) -> Int[np.ndarray, " kept"]:
        """Indices of the channels at one height, in channel order: the azimuth line."""
        return self.at_one_height(np.arange(self.channels))

    def at_one_height(self, channels: Int[np.ndarray, " channels"]) -> Int[np.ndarray, " kept"]:
        """Those of some channels that stand at one height, in their order.

        It is the height of most of them: a row of TX may stand above that of the RX. Of equal rows it is the one
        nearest to TX and RX at the RX's height. A channel of an elevated TX sees the elevation of an echo too.
        """
        height = self.virtual[channels, 2]
        rising = np.argsort(height, kind="stable")
        row = np.empty(len(channels), dtype=np.intp)
        row[rising] = np.cumsum(np.diff(height[rising], prepend=height[rising[0]]) > LEVEL_M)
        members = np.bincount(row)
        away = np.abs(np.bincount(row, height) / members - 2.0 * self.rx[:, 2].mean())
        return channels[row == np.lexsort((away, -members))[0]]

    def unique_elements(
        self, wavelength_m: float
    ) -> tuple[Float64[np.ndarray, "elements 3"], Int[np.ndarray, " channels"]]:
        """(the places [E, 3] of the virtual elements [m], by rising y, then z, then x; at which each channel [C] is).

        Channels are at one place whose coordinates differ by at most :data:`COINCIDENT_WAVELENGTHS`, along every axis,
        directly or through others between them: a row of such channels is one place, however long.
        """
        coordinates = self.virtual[:, [1, 2, 0]]
        rising = np.argsort(coordinates, axis=0, kind="stable")
        apart = np.diff(np.take_along_axis(coordinates, rising, axis=0), axis=0) > COINCIDENT_WAVELENGTHS * wavelength_m
        rank = np.empty(coordinates.shape, dtype=np.intp)
        np.put_along_axis(rank, rising, np.cumsum(np.insert(apart, 0, False, axis=0), axis=0), axis=0)
        _, first, element = np.unique(rank, axis=0, return_index=True, return_inverse=True)
        return self.virtual[first], element.reshape(-1)

    def channel_indices(self, rx: tuple[int, ...]) -> Int[np.ndarray, " kept"]:
        """Indices of the virtual elements that use one of these RX elements, in this array's channel order."""
        unknown = sorted(set(rx) - set(range(len(self.rx_m))))
        if unknown:
            raise ValueError(f"RX {unknown} do not exist; expected indices from 0 to {len(self.rx_m) - 1}")
        return np.flatnonzero(np.isin(self.channel_rx, rx))


def line(y_m: Float[np.ndarray, " elements"]) -> tuple[Position, ...]:
    """Positions of elements along y, for :class:`AntennaArray`."""
    return tuple((0.0, float(y), 0.0) for y in y_m)


def avr_qdm_110() -> AntennaArray:
    """The array of the AVR-QDM-110 (paper, Table 1 and Fig. 4): 3 TX and 16 RX, 48 virtual elements on a 2 mm grid.

    Published: TX at -5, -3, -1 mm, RX at 0, 6, ..., 90 mm; here moved by -45 mm to the RX centroid.
    """
    shift = -45e-3
    return AntennaArray(
        tx_m=line(np.array([-5e-3, -3e-3, -1e-3]) + shift),
        rx_m=line(6e-3 * np.arange(16, dtype=np.float64) + shift),
    )


def virtual_sensor_256(carrier_hz: float) -> AntennaArray:
    """The truth's sensor (paper, section II-B): 1 TX at the origin, 256 RX at half a carrier wavelength [Hz]."""
    spacing = SPEED_OF_LIGHT / (2.0 * carrier_hz)
    with np.errstate(over="ignore"):  # of a carrier near 0 Hz the positions are infinite, and refused
        positions = spacing * (np.arange(256, dtype=np.float64) - 127.5)
    return AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=line(positions))
