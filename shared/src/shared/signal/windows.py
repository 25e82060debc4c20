"""Windows over range and Doppler, and what they do to noise."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64
from scipy.signal import get_window

from shared.radar import Radar


def hann(length: int) -> Float64[np.ndarray, " {length}"]:
    """[length] periodic Hann window, whose centre is sample length / 2: mid-sweep, mid-frame.

    A single sample gets weight 1 (the periodic formula would give 0).
    """
    return get_window("hann", length, fftbins=True) if length > 1 else np.ones(1)


def cell_noise_power(radar: Radar) -> float:
    """Receiver noise [W] in one range-Doppler cell of one channel.

    k T0 F f_s sum(w^2) / sum(w)^2 over both windows: FFTs are divided by their windows' sums, so that an on-grid target
    reads its amplitude.
    """
    power = radar.sample_noise_power_w
    for length in (radar.waveform.samples, radar.waveform.chirps):
        window = hann(length)
        power *= float(np.sum(window**2) / np.sum(window) ** 2)
    return power


ANGLE_WINDOWS = ("none", "taylor-25", "taylor-30", "hann")
"""Windows over the virtual sensor's elements that the truth can be made with."""


def angle_window(name: str, elements: int) -> Float64[np.ndarray, " {elements}"]:
    """[elements] weights over a uniform line array, of mean 1 so that a target keeps reading its amplitude.

    ``taylor-N`` has its first three sidelobes at -N dB (n-bar = 4).

    :raises ValueError: an unknown name
    """
    if name not in ANGLE_WINDOWS:
        raise ValueError(f"angle window {name!r}; expected one of {list(ANGLE_WINDOWS)}")
    if name == "none" or elements < 3:
        return np.ones(elements)
    if name == "hann":
        weights = get_window("hann", elements, fftbins=False)
    else:
        weights = get_window(("taylor", 4, int(name.removeprefix("taylor-"))), elements, fftbins=False)
    return weights / weights.mean()


def point_spread(weights: Float[np.ndarray, " elements"], spacing_wavelengths: float) -> tuple[float, float]:
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
