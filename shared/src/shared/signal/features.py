"""What a network sees of a range-channel matrix: the paper's five channels, or complex rows of known scale and what an
adaptive spectrum makes of them.

One implementation for NumPy and torch: the functions use only what both spell alike, so that the training device
computes what a deployed front end computes with NumPy. Inputs are batched, ``[..., R, C]``, and already hold the chosen
channels alone; ``weights`` are those of :func:`shared.signal.imaging.steering_weights` for the same channels. A row, or
an image, that is all zero gives zeros: no function divides by zero or takes its logarithm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from shared.physics.units import db_to_amplitude
from shared.signal.adaptive import AdaptiveTables, Array, adaptive_spectrum, array_namespace
from shared.signal.model_error import with_model_error

Snapshots = Complex[Array, "*batch rows channels"]
Weights = Complex[Array, "channels bins"]
RowScale = Float[Array, "*batch rows"]
ModelError = float | Float[Array, "*batch"]
"""Share of a row's power that no plane wave explains, one for all or one for each frame; 0.0 for none. See
:func:`shared.signal.model_error.model_error_ratio`."""

MAGNITUDE_FLOOR_DB = -120.0
"""Floor of the logarithmic magnitude below the image's maximum [dB]."""
SIGNAL_TO_NOISE_RANGE = (-2.0, 8.0)
"""Row power over noise power that the fourth complex channel can tell apart, log10."""
SMALLEST_AMPLITUDE = 1e-30
"""Below every amplitude of a radar [sqrt(W)], well inside float32."""

PAPER_CHANNELS = ("log magnitude", "phase", "covariance real", "covariance imaginary", "covariance phase")
COVARIANCE_CHANNELS = ("real", "imaginary", "phase")
ROW_CHANNELS = ("real", "imaginary", "magnitude", "row power over noise")
COMPRESSED = "compressed adaptive magnitude"
ADAPTIVE_CHANNELS = (*ROW_CHANNELS, COMPRESSED)
LARGEST_NOISE = 1e3
"""Noise amplitude over a row's; more makes no difference to an adaptive spectrum."""


def paper_features(range_channel: Snapshots, weights: Weights) -> Float[Array, "*batch 5 rows bins"]:
    """[..., 5, R, U] the paper's input, eq. (7) to (12).

    Logarithmic magnitude of the delay-and-sum image, min-max normalised per image to [0, 1]; its phase [rad]; real
    part, imaginary part and phase [rad] of the covariance of :func:`covariance_rows`.

    :param range_channel: [..., R, C] complex
    :param weights: [C, U] complex
    """
    xp = array_namespace(range_channel)
    unit, scale = unit_rows(range_channel)
    image = unit @ weights
    covariance = covariance_rows(range_channel, weights.shape[-1])
    channels = [
        _log_magnitude(xp, xp.abs(image) * scale),
        xp.angle(image + 0.0),  # a product may sum to -0, whose phase would be pi
        covariance.real,
        covariance.imag,
        xp.angle(covariance),
    ]
    return xp.stack(channels, axis=-3)


def covariance_rows(range_channel: Snapshots, bins: int) -> Complex[Array, "*batch rows {bins}"]:
    """[..., R, bins] unrolled covariance of each range bin, eq. (10) and (11).

    S S^H divided by its own Frobenius norm, which for one snapshot is ||S||^2; of its first n rows and columns the
    upper triangle, row by row, then zeros. n is the largest that fits, 29 for 450 bins.

    :param range_channel: [..., R, C] complex
    """
    xp = array_namespace(range_channel)
    channels = range_channel.shape[-1]
    # Rows and columns of the covariance whose upper triangle fits.
    kept = min(channels, int((np.sqrt(8.0 * bins + 1.0) - 1.0) / 2.0))
    first, second = np.triu_indices(kept)
    padding = bins - len(first)
    weight = np.pad(np.full(len(first), 1.0 / channels, np.float32), (0, padding))
    first, second = (xp.asarray(np.pad(index, (0, padding)), device=range_channel.device) for index in (first, second))
    unit, _ = unit_rows(range_channel)
    return unit[..., first] * xp.conj(unit[..., second]) * xp.asarray(weight, device=range_channel.device)


def covariance_channels(range_channel: Snapshots) -> Float[Array, "*batch 3 rows channels*channels"]:
    """[..., 3, R, C * C] real part, imaginary part and phase [rad] of each range bin's whole covariance, row by row.

    Eq. (13) and (14): S S^H over its Frobenius norm, the input of a direction-of-arrival network.
    """
    xp = array_namespace(range_channel)
    unit, _ = unit_rows(range_channel)
    channels = unit.shape[-1]
    matrix = unit[..., :, None] * xp.conj(unit[..., None, :]) / channels
    flat = matrix.reshape(*unit.shape[:-1], channels * channels)
    return xp.stack([flat.real, flat.imag, xp.angle(flat)], axis=-3)


def row_features(
    range_channel: Snapshots, weights: Weights, noise_power: Float[Array, "*batch"], model_error: ModelError = 0.0
) -> tuple[Float[Array, "*batch 4 rows bins"], RowScale]:
    """Complex delay-and-sum rows of unit RMS, and the scale that was taken out of each.

    An echo's amplitude falls with R^2: an image normalised as a whole is dark beyond ten metres. This function divides
    every range bin by its own RMS over channels. All ranges then weigh alike, no half-precision format overflows, and
    the scale turns an estimate back into sqrt(W). Magnitude images do not depend on a row's common phase. The function
    removes the phase of the row's strongest pixel, which becomes real and positive.

    :param range_channel: [..., R, C] complex [sqrt(W)]
    :param weights: [C, U] complex
    :param noise_power: [...] noise of one channel and cell [W], 0 if there is none
    :param model_error: see :data:`ModelError`; the fourth channel counts it as noise
    :returns: ([..., 4, R, U] real part, imaginary part and magnitude of the image, all within [-1, 1], and the row's
        power over noise, log10 mapped to [0, 1]; [..., R] RMS of the rows [sqrt(W)])
    """
    xp = array_namespace(range_channel)
    unit, scale = unit_rows(range_channel)
    image = unit @ weights
    magnitude = xp.abs(image)
    strongest = xp.take_along_axis if xp is np else xp.take_along_dim
    peak = strongest(image, xp.argmax(magnitude, axis=-1)[..., None], -1)
    # A zero row has no phase; angle(0) = 0 in both libraries.
    image = image * xp.exp(-1j * xp.angle(peak))
    noise = xp.clip(xp.sqrt(noise_power), SMALLEST_AMPLITUDE, None)[..., None, None]
    low, high = SIGNAL_TO_NOISE_RANGE
    over_noise = 2.0 * (xp.log10(xp.clip(scale, SMALLEST_AMPLITUDE, None)) - xp.log10(noise))
    over_noise = xp.clip(over_noise, low, high)
    if not (isinstance(model_error, float) and model_error == 0.0):
        over_noise = -xp.log10(with_model_error(10.0**-over_noise, 1.0, _by_row(model_error, 2)))
    over_noise = (xp.clip(over_noise, low, high) - low) / (high - low)
    level = xp.broadcast_to(over_noise, magnitude.shape)
    stacked = xp.stack([image.real, image.imag, magnitude, xp.asarray(level, dtype=magnitude.dtype)], axis=-3)
    return stacked, scale[..., 0]


def adaptive_features(
    range_channel: Snapshots,
    weights: Weights,
    noise_power: Float[Array, "*batch"],
    tables: AdaptiveTables,
    iterations: int,
    exponent: float,
    model_error: ModelError = 0.0,
) -> tuple[Float[Array, "*batch 5 rows bins"], RowScale]:
    """The channels of :func:`row_features`, and the magnitude of :func:`shared.signal.adaptive.adaptive_spectrum`.

    The latter is compressed as the network's target is: over the row's RMS, to the power ``exponent``. It is an
    estimate already. Arrays change its resolution and little else.

    :param tables: :func:`shared.signal.adaptive.adaptive_tables` of the same channels
    :param iterations: of the adaptive spectrum
    :param model_error: see :data:`ModelError`; both count it as noise
    :returns: ([..., 5, R, U], [..., R] RMS of the rows [sqrt(W)])
    """
    xp = array_namespace(range_channel)
    stacked, scale = row_features(range_channel, weights, noise_power, model_error)
    unit, _ = unit_rows(range_channel)
    noise = relative_noise(noise_power, scale, model_error)
    magnitude = adaptive_spectrum(unit, noise, tables, weights.shape[-1], iterations)
    return xp.concatenate([stacked, (magnitude**exponent)[..., None, :, :]], axis=-3), scale


def snapshot_features(
    range_channel: Snapshots, noise_power: Float[Array, "*batch"], model_error: ModelError = 0.0
) -> tuple[Float[Array, "*batch planes rows 1"], RowScale]:
    """What a network is given that solves for the angles itself: ([..., 2 C + 1, R, 1], [..., R] RMS of the rows).

    Real parts of the C channels of rows of unit RMS, their imaginary parts, and the noise power over the row's.

    :param range_channel: [..., R, C] complex [sqrt(W)]
    :param noise_power: [...] noise of one channel and cell [W], 0 if there is none
    :param model_error: see :data:`ModelError`; it is part of that noise power
    """
    xp = array_namespace(range_channel)
    unit, scale = unit_rows(range_channel)
    noise = relative_noise(noise_power, scale[..., 0], model_error)
    planes = xp.concatenate([unit.real, unit.imag, xp.asarray(noise, dtype=unit.real.dtype)[..., None]], axis=-1)
    return xp.swapaxes(planes, -1, -2)[..., None], scale[..., 0]


def relative_noise(
    noise_power: Float[Array, "*batch"], scale: RowScale, model_error: ModelError = 0.0
) -> Float[Array, "*batch rows"]:
    """[..., R] float32 noise power over that of rows of this RMS [..., R], at most the square of LARGEST_NOISE and what
    the model error adds.

    That of zero rows too, whatever the noise: a quotient by 1 would depend on the unit.

    :param model_error: see :data:`ModelError`
    """
    xp = array_namespace(scale)
    # A quotient of amplitudes: the square of 1e-30 would be zero.
    noise = xp.sqrt(noise_power)[..., None] / xp.where(scale > 0, scale, 1.0)
    noise = xp.where(scale > 0, xp.clip(noise, None, LARGEST_NOISE), LARGEST_NOISE)
    return xp.asarray(with_model_error(noise**2, 1.0, _by_row(model_error, 1)), dtype=xp.float32)


def unit_rows(range_channel: Array) -> tuple[Array, Array]:
    """([..., R, C] rows of unit RMS, [..., R, 1] their RMS); zero rows stay zero.

    The maximum is divided out first, so that no square under- or overflows. Rows below :data:`SMALLEST_AMPLITUDE`
    count as zero: the reciprocal of a subnormal overflows.
    """
    xp = array_namespace(range_channel)
    largest = xp.amax(xp.abs(range_channel), axis=-1, keepdims=True)
    has_signal = largest > SMALLEST_AMPLITUDE
    bounded = xp.where(has_signal, range_channel, 0.0) / xp.where(has_signal, largest, 1.0)
    rms = xp.sqrt(xp.mean(xp.abs(bounded) ** 2, axis=-1, keepdims=True))
    return bounded / xp.where(rms > 0, rms, 1.0), largest * rms


def _by_row(model_error: ModelError, axes: int) -> Array:
    """The model error of each frame [...] with one more axis for its rows, and one for their bins."""
    return model_error if isinstance(model_error, float) else model_error[(..., *[None] * axes)]


def _log_magnitude(xp: Any, magnitude: Array) -> Array:
    """[..., R, U] log10 magnitude with a floor below the image's maximum, min-max normalised per image."""
    largest = xp.amax(magnitude, axis=(-2, -1), keepdims=True)
    relative = magnitude / xp.where(largest > 0, largest, 1.0)
    logarithm = xp.log10(xp.clip(relative, float(db_to_amplitude(MAGNITUDE_FLOOR_DB)), None))
    lowest = xp.amin(logarithm, axis=(-2, -1), keepdims=True)
    span = xp.amax(logarithm, axis=(-2, -1), keepdims=True) - lowest
    return (logarithm - lowest) / xp.where(span > 0, span, 1.0)
