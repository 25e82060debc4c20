"""What the receiver does to the ideal IF signal: phase noise, thermal noise, analogue-to-digital conversion.

In this order, which is that of the hardware. Everything acts on a cube [chirps, samples, channels] in sqrt(W).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from jaxtyping import Complex64
from scipy.linalg import toeplitz

from shared.physics.units import dbm_to_watt
from shared.radar import Radar
from shared.radar.front_end import Converter, PhaseNoise
from shared.radar.waveform import Waveform

Cube = Complex64[np.ndarray, "chirps samples channels"]


@dataclass(frozen=True, eq=False)
class Recorded:
    """A cube as the radar would record it.

    :param cube: [chirps, samples, channels] [sqrt(W)]
    :param saturated: how many parts of its samples, I or Q, left the converter's range
    :param conversion_w: mean power of the converter's rounding in a sample [W]
    """

    cube: Cube
    saturated: int = 0
    conversion_w: float = 0.0


def received(cube: Cube, radar: Radar, generator: np.random.Generator | None) -> Recorded:
    """The cube through the whole receiver.

    :param cube: [chirps, samples, channels] ideal IF signal [sqrt(W)]
    :param generator: of phase and receiver noise; None for a receiver without either
    """
    if generator is not None:
        if radar.front_end.phase_noise is not None:
            cube = with_phase_noise(cube, radar, radar.front_end.phase_noise, generator)
        cube = with_receiver_noise(cube, radar, generator)
    if radar.front_end.converter is None:
        return Recorded(cube)
    return digitised(cube, radar.front_end.converter)


def digitised(cube: Cube, converter: Converter) -> Recorded:
    """The cube with real and imaginary part rounded to the converter's levels.

    Mid-rise: level k stands at (k + 1/2) q for k from -2^(b-1) to 2^(b-1) - 1, with q = 2 a / 2^b and the full scale a
    the amplitude of the stated tone. Within the range, where the signal is busy, the error is uniform over a step:
    q^2 / 12 of each part, i.e. 6.02 b + 1.76 dB below a tone of full scale (Bennett, Bell Syst. Tech. J. 27, 1948). Of
    noise far below a step only the sign is left, q / 2: q^2 / 4 of each part. So the error is measured, of what is
    within the range: what is cut off becomes harmonics of the strongest echo, no noise. A frame's ``noise_power`` takes
    it for white, as it is where noise moves the signal by a step, or where there is noise alone.
    """
    half = 2 ** (converter.bits - 1)
    step = float(np.sqrt(dbm_to_watt(converter.full_scale_dbm))) / half
    result, saturated, error = np.empty_like(cube), 0, 0.0
    for ideal, recorded in zip(cube, result, strict=True):  # chirp by chirp: the float64 copies stay small
        for part in ("real", "imag"):
            steps = getattr(ideal, part).astype(np.float64) / step
            level = np.floor(steps)
            saturated += int(np.count_nonzero((level < -half) | (level >= half)))
            level = np.clip(level, -half, half - 1) + 0.5
            error += float(np.sum((level - np.clip(steps, -half, half)) ** 2))
            getattr(recorded, part)[...] = level * step
    return Recorded(result, saturated, error * step**2 / cube.size)


def with_phase_noise(cube: Cube, radar: Radar, noise: PhaseNoise, generator: np.random.Generator) -> Cube:
    """The cube under the oscillator's phase noise, with the range correlation that a shared oscillator gives.

    The mixer leaves phi(t) - phi(t - tau) on an echo of delay tau: noise slower than 1 / tau cancels (Budge and Burt,
    "Range correlation effects in radars", IEEE National Radar Conference 1993), which multiplies the spectrum of phi by
    4 sin^2(pi f tau). To first order in that phase the tone of range bin r turns into itself and, m bins away,

        D_m(r) = j Phi_m (1 - exp(-j 2 pi (m / T_c) tau_r)),   tau_r = r / B,

    with Phi_m the Fourier coefficients of phi over the chirp, Phi_-m = Phi_m*, E |Phi_m|^2 = L(m / T_c) / T_c. Valid
    while the phase left is small against 1 rad (:meth:`shared.radar.front_end.PhaseNoise.residual_rad`; ``load_radar``
    refuses more). All RX share the draw; all chirps, and TX that send one after the other, have their own: what is
    correlated from one chirp to the next lies below 1 / T_c, where it has cancelled. Sidebands beyond the sampled band
    are filtered off.
    """
    waveform = radar.waveform
    bins = waveform.samples
    tx_of = radar.array.channel_tx if waveform.multiplexing == "tdm" else np.zeros(cube.shape[2], dtype=np.intp)
    turns = [np.flatnonzero(tx_of == tx) for tx in range(int(tx_of.max()) + 1)]
    deviation = np.sqrt(
        noise.density_per_hz(np.arange(1, bins) / waveform.chirp_duration_s) / waveform.chirp_duration_s / 2.0
    )
    correlation = _range_correlation(waveform)
    result = np.empty_like(cube)
    for m, chirp in enumerate(cube):
        spectrum = scipy.fft.fft(chirp, axis=0)
        for channels in turns:
            draw = generator.standard_normal((2, bins - 1)) * deviation
            phase = np.concatenate([[0.0], draw[0] + 1j * draw[1]]).astype(np.complex64)  # Phi_m, m >= 0
            spread = toeplitz(phase, phase.conj()) * correlation  # [to, from]: m = to - from
            spectrum[:, channels] += 1j * (spread @ spectrum[:, channels])
        result[m] = scipy.fft.ifft(spectrum, axis=0)
    return result


@lru_cache(maxsize=2)
def _range_correlation(waveform: Waveform) -> Complex64[np.ndarray, "bins bins"]:
    """[to, from] 1 - exp(-j 2 pi f tau) of bins: f = (to - from) / T_c, tau = from / B."""
    index = np.arange(waveform.samples)
    cycles = (index[:, None] - index) * index / (waveform.chirp_duration_s * waveform.bandwidth_hz)
    factor = (1.0 - np.exp(-2j * np.pi * cycles)).astype(np.complex64)
    factor.setflags(write=False)
    return factor


def with_receiver_noise(cube: Cube, radar: Radar, generator: np.random.Generator) -> Cube:
    """The cube and circular white Gaussian noise of k T0 F f_s [W] a sample.

    It is drawn and added chirp by chirp, so that the noise stays in the cache.
    """
    deviation = np.float32(np.sqrt(radar.sample_noise_power_w / 2.0))
    result, noise = np.empty_like(cube), np.empty((*cube.shape[1:], 2), dtype=np.float32)
    for ideal, recorded in zip(cube, result, strict=True):
        generator.standard_normal(out=noise, dtype=np.float32)
        np.multiply(noise, deviation, out=noise)
        np.add(ideal, noise.view(np.complex64)[..., 0], out=recorded)
    return result
