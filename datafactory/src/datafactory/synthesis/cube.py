"""PathTable to radar cube: the IF signal of eq. (1)-(2) for every chirp, sample and channel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.spread import add_moments
from shared.arrays import AntennaArray
from shared.radar import Radar
from shared.signal import chirp_times
from shared.sweep import reference_frequency_hz, shift_error, shift_polynomials, sweep_positions
from shared.units import SPEED_OF_LIGHT
from shared.waveform import Waveform

OVERSAMPLING = 2
"""Range cells a bin: the remainder is half as wide as with 1 and needs fewer moments, for FFTs twice as long."""
FLOAT32_TOLERANCE = 3e-7
"""Below this, sums in float32 no longer keep the promise and the cube is made in complex128."""
BLOCK_REACH_BINS = 0.205
"""RX are worked on in blocks whose delays spread by at most this many bins to either side of the block's centre."""


@dataclass(frozen=True)
class _Contribution:
    """Paths with the TX they serve and the starts of that TX's chirps [s]."""

    paths: ScatteredPaths
    tx: slice
    start: NDArray[np.float64]


def cube_of_paths(
    paths: PathTable, radar: Radar, tolerance: float = 1e-6, array: AntennaArray | None = None, threads: int = 1
) -> NDArray[np.complex64] | NDArray[np.complex128]:
    """[chirps, samples, channels] noise-free IF signal of illuminated paths (amplitudes in sqrt(W)).

    :param tolerance: bound on the relative L2 error against the float64 sum; complex64 down to 3e-7, else complex128
    :param array: another array than the radar's own, e.g. its virtual sensor
    :param threads: chirps worked on at once
    """
    array = array or radar.array
    waveform = radar.waveform
    dtype = np.complex64 if tolerance >= FLOAT32_TOLERANCE else np.complex128
    static = not paths.moves()
    computed = 1 if static else waveform.chirps
    cube = np.zeros((computed, waveform.samples, len(array.rx_m), len(array.tx_m)), dtype=dtype)
    times = chirp_times(radar.model_copy(update={"array": array}))[:, :computed]
    contributions = _contributions(paths, array, times)
    with ThreadPoolExecutor(threads) as pool:
        for block in _blocks(array, waveform.bandwidth_hz) if contributions else []:
            _add_block(cube, contributions, radar, array, block, tolerance, pool)
    channels = cube.reshape(computed, waveform.samples, array.channels)
    return np.repeat(channels, waveform.chirps, axis=0) if static and waveform.chirps > 1 else channels


def _contributions(paths: PathTable, array: AntennaArray, times: NDArray[np.float64]) -> list[_Contribution]:
    """Parts of the table: all TX at once where delays factorise, else each TX alone."""
    everyone = range(len(array.tx_m))
    parts = []
    if len(paths.scattered):
        scattered = _by_range(paths.scattered)
        if np.all(times == times[0]):
            parts.append(_Contribution(scattered, slice(0, len(everyone)), times[0]))
        else:  # TDM: the targets have moved on when the next TX sends
            parts += [_Contribution(scattered, slice(i, i + 1), times[i]) for i in everyone]
    if len(paths.specular):
        for i in everyone:
            parts.append(_Contribution(_by_range(paths.specular.as_scattered(array.tx[i])), slice(i, i + 1), times[i]))
    return parts


def _by_range(paths: ScatteredPaths) -> ScatteredPaths:
    return paths.take(np.argsort(paths.range_m(), kind="stable"))


def _blocks(array: AntennaArray, bandwidth_hz: float) -> list[slice]:
    """RX indices in their order, cut so that no block is wider than BLOCK_REACH_BINS to either side of its centre."""
    rx = array.rx
    blocks, first = [], 0
    for last in range(1, len(rx) + 1):
        if last == len(rx) or _reach(rx[first : last + 1], bandwidth_hz) > BLOCK_REACH_BINS:
            blocks.append(slice(first, last))
            first = last
    return blocks


def _reach(elements: NDArray[np.float64], bandwidth_hz: float) -> float:
    """Largest distance from the elements' centre, as a delay in range bins."""
    return float(np.linalg.norm(elements - _centre(elements), axis=1).max()) * bandwidth_hz / SPEED_OF_LIGHT


def _centre(elements: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 * (elements.min(axis=0) + elements.max(axis=0))


def terms_for(reach_bins: float, tolerance: float) -> int:
    """Least number of moments whose remainder stays within a third of the tolerance (the rest is rounding)."""
    terms = 1
    while shift_error(reach_bins, terms) > tolerance / 3.0:
        terms += 1
    return terms


@lru_cache(maxsize=8)
def _polynomials(waveform: Waveform, reach: float, terms: int) -> NDArray[np.complex128]:
    """[terms, samples] shift polynomials of the waveform, the same for every block of one width and every frame."""
    polynomials = shift_polynomials(sweep_positions(waveform.samples), reach, terms)
    if waveform.residual_video_phase:
        polynomials = _with_video_phase(polynomials, waveform.bandwidth_hz * waveform.chirp_duration_s)
    polynomials.setflags(write=False)
    return polynomials


def _with_video_phase(polynomials: NDArray[np.complex128], time_bandwidth: float) -> NDArray[np.complex128]:
    """Polynomials in z times exp(-j pi z^2 / (B T_c)): the residual video phase -mu (z / B)^2 / 2 of the remainder."""
    result = polynomials.copy()
    factor = 1.0 + 0.0j
    for power in range(1, (len(polynomials) + 1) // 2):
        factor *= -1j * np.pi / (time_bandwidth * power)
        result[2 * power :] += factor * polynomials[: -2 * power]
    return result


def _add_block(
    cube: NDArray,
    contributions: list[_Contribution],
    radar: Radar,
    array: AntennaArray,
    block: slice,
    tolerance: float,
    pool: ThreadPoolExecutor,
) -> None:
    """Add the echoes at one block of RX to ``cube`` [chirps, samples, RX, TX], one task a chirp."""
    waveform = radar.waveform
    tx, rx = array.tx, array.rx[block]
    reach = 0.5 / OVERSAMPLING + _reach(tx, waveform.bandwidth_hz) + _reach(rx, waveform.bandwidth_hz)
    reach = np.ceil(reach * 1e6) * 1e-6  # blocks of one width differ in the last digits, and share their polynomials
    terms = terms_for(reach, tolerance)
    polynomials = _polynomials(waveform, reach, terms).astype(cube.dtype)
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    outputs = np.arange(waveform.samples) - waveform.samples // 2
    real = np.float32 if cube.dtype == np.complex64 else np.float64
    tx_centre, rx_centre = _centre(tx), _centre(rx)

    def chirp(m: int) -> None:
        moments = np.zeros((OVERSAMPLING * waveform.samples, terms, 2 * len(tx) * len(rx)), dtype=real)
        for part in contributions:
            paths = part.paths
            add_moments(
                paths.tx_point, paths.rx_point, paths.tx_velocity, paths.rx_velocity,
                paths.between_m, paths.between_rate_mps, paths.amplitude,
                tx[part.tx], rx, tx_centre, rx_centre, float(part.start[m]),
                reference_frequency_hz(radar), waveform.bandwidth_hz, waveform.slope_hz_per_s,
                float(waveform.residual_video_phase), OVERSAMPLING,
                moments[:, :, 2 * part.tx.start * len(rx) : 2 * part.tx.stop * len(rx)],
            )  # fmt: skip
        spectra = scipy.fft.ifft(moments.view(cube.dtype), axis=0, norm="forward", overwrite_x=True)
        signal = np.einsum("pn,npc->nc", polynomials, spectra[outputs])
        cube[m][:, block] += signal.reshape(waveform.samples, len(tx), len(rx)).transpose(0, 2, 1)

    list(pool.map(chirp, range(len(cube))))
