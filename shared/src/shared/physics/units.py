"""Physical constants and the conversions that every package shares."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    ArrayOrScalar = np.ndarray
else:
    ArrayOrScalar = np.ndarray | np.generic
"""What NumPy returns: of zero-dimensional arrays it makes scalars, which have the methods of an array."""

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m/s], exact by the definition of the metre."""

BOLTZMANN = 1.380_649e-23
"""Boltzmann constant [J/K], exact by the definition of the kelvin."""

REFERENCE_TEMPERATURE = 290.0
"""Reference temperature of noise figures [K] (Friis, Proc. IRE 32, 1944)."""

FARTHEST_M = 1e9
"""Largest coordinate that is read [m]: beyond every map of the Earth, and its square is far within float32."""

FASTEST_MPS = 1e5
"""Largest component of a velocity that is read [m/s]: faster than any satellite."""


def db_to_power(value_db: ArrayLike) -> Float64[ArrayOrScalar, ...]:
    """Power ratio of a level [dB]: ``10 ** (value / 10)``, element by element."""
    return np.power(10.0, np.asarray(value_db, dtype=np.float64) / 10.0)


def db_to_amplitude(value_db: ArrayLike) -> Float64[ArrayOrScalar, ...]:
    """Magnitude ratio of a level [dB]: ``10 ** (value / 20)``, element by element."""
    return np.power(10.0, np.asarray(value_db, dtype=np.float64) / 20.0)


def power_to_db(power: ArrayLike, floor_db: float = -400.0) -> Float64[ArrayOrScalar, ...]:
    """Level [dB] of a power ratio; zero and everything below ``floor_db`` reads ``floor_db``, so it is always
    finite.
    """
    power = np.asarray(power, dtype=np.float64)
    return 10.0 * np.log10(np.maximum(power, db_to_power(floor_db)))


def amplitude_to_db(amplitude: ArrayLike, floor_db: float = -400.0) -> Float64[ArrayOrScalar, ...]:
    """Level [dB] of a magnitude ratio, ``20 log10 |amplitude|``; finite like :func:`power_to_db`."""
    magnitude = np.abs(np.asarray(amplitude))
    return 20.0 * np.log10(np.maximum(magnitude.astype(np.float64), db_to_amplitude(floor_db)))


def dbm_to_watt(level_dbm: float) -> float:
    """Power [W] of a level [dBm]."""
    return 1e-3 * 10.0 ** (level_dbm / 10.0)
