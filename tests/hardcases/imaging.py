"""Hard cases of images and features: nothing, constants, extreme values, short formats; in NumPy and in torch alike.

References are the same sums in float64, or the same input at another scale: a feature may depend on the scale only
through the normalisation that its docstring states.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import small_radar
from numpy.typing import NDArray
from oracles import relative_error

from shared.signal.features import covariance_channels, covariance_rows, paper_features, row_features
from shared.signal.imaging import delay_and_sum, near_field_images, steering_matrix, steering_weights
from shared.signal.spectrum import select_doppler

ROWS, NOISE_W = 12, 1e-12
SMALLEST_SUBNORMAL = float(np.finfo(np.float32).smallest_subnormal)

Features = dict[str, NDArray[np.float64]]


def _signal(rows: int = ROWS) -> NDArray[np.complex64]:
    """[rows, C] of magnitude about 1, every row another direction, noise 40 dB down."""
    radar = small_radar()
    generator = np.random.default_rng(5)
    u = generator.uniform(-0.8, 0.8, rows)
    wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
    plane = np.exp(-1j * wavenumber * u[:, None] * radar.array.virtual[None, :, 1])
    noise = generator.standard_normal((rows, radar.array.channels, 2)) @ np.array([1.0, 1j])
    return (plane + 0.01 * noise).astype(np.complex64)


def _features(signal: NDArray[np.complex64], noise_power: float = NOISE_W, torch: bool = False) -> Features:
    """Every feature of a range-channel matrix [R, C], as float64 arrays."""
    radar = small_radar()
    weights = steering_weights(radar, np.arange(radar.array.channels))
    given: tuple[Any, Any, Any] = signal, weights, np.float32(noise_power)
    if torch:
        import torch as library

        matrix, steer, noise = (library.as_tensor(value) for value in given)
    else:
        matrix, steer, noise = given
    rows, scale = row_features(matrix, steer, noise)
    covariance = covariance_rows(matrix, 30)
    made = {
        "paper": paper_features(matrix, steer),
        "rows": rows,
        "scale": scale,
        "covariance real": covariance.real,
        "covariance imaginary": covariance.imag,
        "channels": covariance_channels(matrix),
    }
    return {name: np.asarray(value, dtype=np.float64) for name, value in made.items()}


def _both(signal: NDArray[np.complex64], check: Callable[[Features], float]) -> float:
    """The larger of a check's two results, for NumPy's features and for torch's."""
    return max(check(_features(signal)), check(_features(signal, torch=True)))


def _not_finite(features: Features) -> float:
    return float(sum(np.count_nonzero(~np.isfinite(values)) for values in features.values()))


def _beyond_unit(features: Features) -> float:
    """Values that are not finite, or beyond what the features promise: phases within pi, all else within 1."""
    phases = np.concatenate([features["paper"][[1, 4]].ravel(), features["channels"][2].ravel()])
    others = [features["paper"][[0, 2, 3]], features["rows"], features["channels"][:2]]
    beyond = np.count_nonzero(np.abs(phases) > np.pi * (1 + 1e-6))
    return _not_finite(features) + beyond + sum(np.count_nonzero(np.abs(part) > 1.0 + 1e-5) for part in others)


def _zero_rows() -> float:
    """Features of all-zero range bins that are not zero, or not finite; other rows stand beside them."""
    signal = _signal()
    signal[[0, 5, -1]] = 0.0

    def check(features: Features) -> float:
        # The fourth row channel is a level: of a row without power it is the lowest, which is 0 too.
        silent = [features["rows"][:, [0, 5]], features["scale"][[0, 5]], features["channels"][:, [0, 5]]]
        silent += [
            features["paper"][1:, [0, 5]],
            features["covariance real"][[0, 5]],
            features["covariance imaginary"][[0, 5]],
        ]
        return _not_finite(features) + sum(np.count_nonzero(part) for part in silent)

    return _both(signal, check)


def _noise_row() -> float:
    signal = np.zeros_like(_signal())
    signal[3] = np.float32(np.sqrt(NOISE_W)) * _signal()[3]
    return _both(signal, _beyond_unit)


def _constant() -> float:
    return _both(np.full_like(_signal(), 0.25 + 0.25j), _beyond_unit)


def _subnormal() -> float:
    """Features of values at float32's very end, where they have a bit or two, that leave their range."""
    signal = np.full_like(_signal(), SMALLEST_SUBNORMAL)
    signal[1] *= -1j
    signal[2, 1:] = 0.0
    return _both(signal, _beyond_unit)


def _scaled(scale: float) -> float:
    """Largest difference between the features of a signal and of the same signal times ``scale``.

    The scale itself, and the level over noise that is made of it, are compared after dividing it out.
    """
    # A power of two changes no digit: what differs is the arithmetic's doing.
    exact = np.float32(2.0 ** round(np.log2(scale)))
    worst = 0.0
    for torch in (False, True):
        plain = _features(_signal(), 1.0, torch)
        scaled = _features(_signal() * exact, 1.0, torch)
        scaled["scale"] = scaled["scale"] / np.float64(exact)
        level = plain["rows"].shape[0] - 1
        for features in (plain, scaled):
            features["rows"] = np.delete(features["rows"], level, axis=0)
        worst = max(worst, *(float(np.abs(plain[name] - scaled[name]).max()) for name in plain))
    return worst


def _delay_and_sum_scaled(scale: float) -> float:
    """Relative error of delay-and-sum in complex64 against float64, at an extreme level."""
    radar = small_radar()
    signal = (_signal() * np.float32(scale)).astype(np.complex64)
    exact = signal.astype(np.complex128) @ steering_matrix(radar, radar.array) / radar.array.channels
    return relative_error(delay_and_sum(signal, radar).astype(np.complex128) / scale, exact / scale)


def _near_field_scaled(scale: float) -> float:
    """Relative difference of truth images of moments at an extreme level, after dividing it out."""
    radar = small_radar(samples=16, range_bins=8)
    generator = np.random.default_rng(3)
    shape = (1, 3, 8, radar.virtual_sensor.channels)
    moments = (generator.standard_normal((*shape, 2)) @ np.array([1.0, 1j])).astype(np.complex64)
    exact = np.float32(2.0 ** round(np.log2(scale)))
    plain = near_field_images(moments, radar, radar.virtual_sensor).astype(np.complex128)
    scaled = near_field_images(moments * exact, radar, radar.virtual_sensor).astype(np.complex128) / np.float64(exact)
    return relative_error(scaled, plain)


def _doppler_choice(scale: float) -> float:
    """Doppler cells that differ between spectra and the same spectra at an extreme level, or values not finite."""
    generator = np.random.default_rng(4)
    spectra = (generator.standard_normal((20, 16, 12, 2)) @ np.array([1.0, 1j])).astype(np.complex64)
    exact = np.float32(2.0 ** round(np.log2(scale)))
    plain, scaled = select_doppler(spectra, 0.1), select_doppler(spectra * exact, 0.1 * float(exact) ** 2)
    return float(np.count_nonzero(plain.cells != scaled.cells) + np.count_nonzero(~np.isfinite(scaled.magnitude)))


def _float32_features() -> float:
    """Largest error of the float32 features against the same functions in float64, phases of empty cells aside."""
    radar = small_radar()
    weights = steering_weights(radar, np.arange(radar.array.channels)).astype(np.complex128)
    rows, _ = row_features(_signal().astype(np.complex128), weights, np.float64(NOISE_W))
    covariance = covariance_rows(_signal().astype(np.complex128), 30)
    single = _features(_signal())
    exact = {"rows": rows, "covariance real": covariance.real, "covariance imaginary": covariance.imag}
    return max(float(np.abs(single[name] - value).max()) for name, value in exact.items())


CASES = (
    HardCase("all-zero range bins", "log of zero, division by a zero norm", 0.0, "wrong values", _zero_rows),
    HardCase("one range bin of noise", "normalised by almost nothing", 0.0, "wrong values", _noise_row),
    HardCase("a constant matrix", "a span of zero", 0.0, "wrong values", _constant),
    HardCase("subnormals", "squares and reciprocals vanish or overflow", 0.0, "wrong values", _subnormal),
    HardCase("features at 1e-20", "squares underflow", 2e-6, "absolute", lambda: _scaled(1e-20)),
    HardCase("features at 1e20", "squares overflow", 2e-6, "absolute", lambda: _scaled(1e20)),
    HardCase("delay-and-sum at 1e-20", "as above", 1e-6, "relative", lambda: _delay_and_sum_scaled(1e-20)),
    HardCase("delay-and-sum at 1e20", "as above", 1e-6, "relative", lambda: _delay_and_sum_scaled(1e20)),
    HardCase("truth image at 1e-20", "as above", 1e-6, "relative", lambda: _near_field_scaled(1e-20)),
    HardCase("truth image at 1e20", "as above", 1e-6, "relative", lambda: _near_field_scaled(1e20)),
    HardCase("Doppler choice at 1e-15", "thresholds with constants", 0.0, "cells", lambda: _doppler_choice(1e-15)),
    HardCase("Doppler choice at 1e20", "as above", 0.0, "cells", lambda: _doppler_choice(1e20)),
    HardCase("features in float32", "rounding against float64", 1e-6, "absolute", _float32_features),
)  # fmt: skip
