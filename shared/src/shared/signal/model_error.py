"""What no plane wave explains of a measured row, as a share of the row's power.

Channels that differ in gain and phase, couple, or stand elsewhere than they should leave a residual beside every echo.
It grows with the echo, which thermal noise does not. An estimator that is told the thermal noise alone explains the
residual by targets that are not there. Told the sum of both as noise it does not:

    noise_row = sigma^2 + 10^(e / 10) mean_c |x_c|^2

with e the model error [dB]. The sum is exact for residuals that are white over the channels, independent of the noise,
and of the same share for every echo. Weak targets beside a strong one, below e less the array's gain, are lost with it.

Measured on 77 GHz boards: calibrated with one capture, a plane wave leaves -19 to -21 dB of the power of a reflector in
another, at a signal-to-noise ratio of 52 to 62 dB.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from shared.physics.errors import InputError
from shared.physics.units import ArrayOrScalar, db_to_power

NO_MODEL_ERROR_DB = -math.inf
"""Of simulated data: its waves are those of the model."""
UNCALIBRATED_DB = -25.0
"""Of a capture whose calibration does not say what it leaves [dB of the row's power]."""


def model_error_ratio(model_error_db: float) -> float:
    """Power over the row's power of a model error [dB]; 0 for :data:`NO_MODEL_ERROR_DB`.

    :raises InputError: above 0 dB, or not a number
    """
    if not model_error_db <= 0.0:
        raise InputError("model_error_db", repr(model_error_db), "at most 0 dB of the row's power, -inf for none")
    return float(db_to_power(model_error_db))


def with_model_error(noise_power: Any, row_power: Any, model_error: Any) -> Any:
    """sigma^2 plus the share ``model_error`` of the row's power mean_c |x_c|^2, in one unit, of NumPy or torch; they
    broadcast."""
    return noise_power + model_error * row_power


def row_noise(
    snapshots: Complex[np.ndarray, "*rows channels"], noise_power: float, model_error_db: float
) -> Float[ArrayOrScalar, "*rows"]:
    """[...] noise power of each row [W] that an estimator is to be told, float64.

    :param snapshots: [..., C] the channels that it is given [sqrt(W)]
    :param noise_power: of one channel in one range-Doppler cell [W]
    :param model_error_db: of those channels [dB of the row's power], :data:`NO_MODEL_ERROR_DB` for none
    :raises InputError: a model error above 0 dB
    """
    values = np.asarray(snapshots, dtype=np.complex128)
    power = np.mean(values.real**2 + values.imag**2, axis=-1)
    return with_model_error(noise_power, power, model_error_ratio(model_error_db))
