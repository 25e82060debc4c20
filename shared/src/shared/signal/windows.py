"""Windows over range, Doppler and the elements of a line, their responses, and what they do to noise."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex128, Float, Float64, Integer
from numpy.typing import ArrayLike

from shared.physics.units import ArrayOrScalar, db_to_amplitude
from shared.processes.defaults import ANGLE_WINDOWS
from shared.radar import Radar
from shared.radar.waveform import Waveform


def hann(length: int) -> Float64[np.ndarray, " {length}"]:
    """[length] periodic Hann window, whose centre is sample length / 2: mid-sweep, mid-frame.

    A single sample gets weight 1 (the periodic formula would give 0). To the last bit what ``scipy.signal.get_window``
    gives, without its import: every process that renders needs this window, and ``scipy.signal`` takes 0.4 s.
    """
    return _symmetric_hann(length + 1)[:-1] if length > 1 else np.ones(1)


def unit_hann(length: int) -> Float64[np.ndarray, " {length}"]:
    """[length] :func:`hann` of sum 1: with it a transform reads the amplitude of a target on the grid."""
    window = hann(length)
    return window / window.sum()


def hann_noise_share(length: int) -> float:
    """sum(w^2) / sum(w)^2 of :func:`hann`: white noise in a bin of its transform by :func:`unit_hann`, over a sample's
    power."""
    window = hann(length)
    return float(np.sum(window**2) / np.sum(window) ** 2)


def _symmetric_hann(length: int) -> Float64[np.ndarray, " {length}"]:
    """[length] Hann window whose first and last weights are 0; length at least 2."""
    return 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, length))


def hann_response(offset: ArrayLike) -> Float64[ArrayOrScalar, ...]:
    """Of :func:`unit_hann` of many samples to a target ``offset`` bins off, about its centre: sinc(x) / (1 - x^2)."""
    x = np.asarray(offset, dtype=np.float64)
    rest = 1.0 - x**2
    edge = np.abs(rest) < 1e-9
    return np.where(edge, 0.5, np.sinc(x) / np.where(edge, 1.0, rest))


def hann_slope(offset: Float[np.ndarray, "*any"]) -> Float64[np.ndarray, "*any"]:
    """Derivative of :func:`hann_response` by x [1 / bin]: central differences, within 1e-7 of it."""
    half_step = 1e-5
    return (hann_response(offset + half_step) - hann_response(offset - half_step)) / (2.0 * half_step)


def hann_spectrum(offset: Float[np.ndarray, "*any"]) -> Complex128[np.ndarray, "*any"]:
    """As :func:`hann_response`, about the first sample."""
    return hann_response(offset) * np.exp(1j * np.pi * offset)


LEAST_OFFSET = 1.5
"""Bins from a peak where the window's response has fallen and its envelope begins."""


def hann_envelope_db(offset: Float[np.ndarray, "*any"]) -> Float64[np.ndarray, "*any"]:
    """Level of :func:`hann_response` at most [dB]: 0 below 1.5 bins, then its envelope 1 / (pi x (x^2 - 1))."""
    distance = np.maximum(np.abs(offset), LEAST_OFFSET)
    fallen = -20.0 * np.log10(np.pi * distance * (distance**2 - 1.0))
    return np.where(np.abs(offset) < LEAST_OFFSET, 0.0, fallen)


def hann_correlation(bins: Integer[np.ndarray, "*any"]) -> Float64[np.ndarray, "*any"]:
    """Of white noise in two bins of a Hann windowed spectrum, by their distance: the spectrum of its square."""
    return np.array([1.0, 2.0 / 3.0, 1.0 / 6.0, 0.0])[np.minimum(np.abs(bins), 3)]


def cell_noise_power(radar: Radar) -> float:
    """Receiver noise [W] in one range-Doppler cell of one channel: k T0 F f_s a sample."""
    return power_in_cell(radar.sample_noise_power_w, radar.waveform)


def power_in_cell(sample_power_w: float, waveform: Waveform) -> float:
    """Power [W] in one range-Doppler cell of white noise of ``sample_power_w`` a sample."""
    return sample_power_w * hann_noise_share(waveform.samples) * hann_noise_share(waveform.chirps)


def angle_window(name: str, elements: int) -> Float64[np.ndarray, " {elements}"]:
    """[elements] weights over a uniform line array, of mean 1 so that a target keeps reading its amplitude.

    ``taylor-N`` has its first three sidelobes at -N dB (n-bar = 4).

    :raises ValueError: an unknown name
    """
    if name not in ANGLE_WINDOWS:
        raise ValueError(f"angle window {name!r}; expected one of {list(ANGLE_WINDOWS)}")
    if name == "none" or elements < 3:
        return np.ones(elements)
    weights = _symmetric_hann(elements) if name == "hann" else _taylor(elements, float(name.removeprefix("taylor-")))
    return weights / weights.mean()


LEVEL_SIDELOBES = 4
"""n-bar of a Taylor window: one less of them have its level on either side."""


def _taylor(length: int, sidelobe_db: float) -> Float64[np.ndarray, " {length}"]:
    """[length] Taylor window, symmetric: W. G. Carrara, R. S. Goodman, R. M. Majewski, Spotlight Synthetic Aperture
    Radar, Artech House, 1995, appendix D.2, as in ``scipy.signal.windows.taylor``, again without its import.

    :param sidelobe_db: the main lobe over the first sidelobes
    """
    a = np.arccosh(db_to_amplitude(sidelobe_db)) / np.pi
    stretch = LEVEL_SIDELOBES**2 / (a**2 + (LEVEL_SIDELOBES - 0.5) ** 2)
    order = np.arange(1.0, LEVEL_SIDELOBES)
    above = (1.0 - order[:, None] ** 2 / stretch / (a**2 + (order - 0.5) ** 2)).prod(axis=1)
    ratio = 1.0 - order[:, None] ** 2 / order**2
    below = 2.0 * np.where(ratio == 0.0, 1.0, ratio).prod(axis=1)
    coefficients = (-1.0) ** (order + 1.0) * above / below
    centred = np.arange(length) - length / 2.0 + 0.5
    return 1.0 + 2.0 * coefficients @ np.cos(2.0 * np.pi * order[:, None] * centred / length)


def width_and_sidelobe(weights: Float[np.ndarray, " elements"], spacing_wavelengths: float) -> tuple[float, float]:
    """-3 dB width in u and peak sidelobe level [dB] of a uniform line array with these weights, broadside, one way."""
    oversampling = 64
    length = oversampling * 2 ** int(np.ceil(np.log2(len(weights))))
    response = np.abs(np.fft.fft(weights, length)) / weights.sum()
    half = response[: length // 2]
    edge = int(np.argmax(half < np.sqrt(0.5)))
    fraction = (half[edge - 1] - np.sqrt(0.5)) / (half[edge - 1] - half[edge])
    rising = np.flatnonzero(np.diff(half) > 0)
    sidelobe = half[rising[0] :].max() if len(rising) else 0.0
    width = 2.0 * (edge - 1 + fraction) / length / spacing_wavelengths
    return float(width), float(20.0 * np.log10(max(sidelobe, 1e-20)))
