"""Windows over range and Doppler, and what they do to noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import get_window

from shared.radar import Radar


def hann(length: int) -> NDArray[np.float64]:
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
