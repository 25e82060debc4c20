"""PathTable to radar cube: the IF signal of eq. (1)-(2) for every chirp, sample and channel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

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

OVERSAMPLING = 2
"""Range cells a bin: twice the FFT length for a third fewer moments; measured fastest at 1e5 paths."""
FLOAT32_TOLERANCE = 3e-7
"""Below this, sums in float32 no longer keep the promise and the cube is made in complex128."""
BLOCK_REACH_BINS = 0.2
"""RX are worked on in blocks whose delays spread by at most this many bins to either side of the block's centre."""


@dataclass(frozen=True)
class Block:
    """RX that share one range cell a path: ``rx`` is the slice of RX indices."""

    rx: slice
    reach_bins: float


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
    with ThreadPoolExecutor(threads) as pool:
        for scattered, tx_indices, start in _contributions(paths, array, times):
            for block in _blocks(array, waveform.bandwidth_hz):
                _add_block(cube, scattered, radar, array, block, tx_indices, start, tolerance, pool)
    cube = cube.reshape(computed, waveform.samples, array.channels)
    return np.repeat(cube, waveform.chirps, axis=0) if static and waveform.chirps > 1 else cube


def _contributions(paths: PathTable, array: AntennaArray, times):
    """Parts of the table with the TX they serve and their chirp times: all TX at once, or each alone where it must be."""
    together = bool(np.all(times == times[0]))
    everyone = list(range(len(array.tx_m)))
    for tx_indices in [everyone] if together else [[i] for i in everyone]:
        if len(paths.scattered):
            yield _by_range(paths.scattered), tx_indices, times[tx_indices[0]]
    for i in everyone:
        if len(paths.specular):
            yield _by_range(paths.specular.as_scattered(array.tx[i])), [i], times[i]


def _by_range(paths: ScatteredPaths) -> ScatteredPaths:
    return paths.take(np.argsort(paths.range_m(), kind="stable"))


def _blocks(array: AntennaArray, bandwidth_hz: float) -> list[Block]:
    """RX in their order, cut so that no block is wider than BLOCK_REACH_BINS to either side of its centre."""
    rx = array.rx
    blocks, first = [], 0
    for last in range(1, len(rx) + 1):
        if last == len(rx) or _reach(rx[first : last + 1], bandwidth_hz) > BLOCK_REACH_BINS:
            blocks.append(Block(slice(first, last), _reach(rx[first:last], bandwidth_hz)))
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


def _add_block(cube, paths, radar, array, block, tx_indices, start, tolerance, pool) -> None:
    waveform = radar.waveform
    tx, rx = array.tx[tx_indices], array.rx[block.rx]
    reach = 0.5 / OVERSAMPLING + _reach(tx, waveform.bandwidth_hz) + _reach(rx, waveform.bandwidth_hz)
    terms = terms_for(reach, tolerance)
    polynomials = shift_polynomials(sweep_positions(waveform.samples), reach, terms).astype(cube.dtype)
    cells = OVERSAMPLING * waveform.samples
    real = np.float32 if cube.dtype == np.complex64 else np.float64
    width = len(rx) * len(tx)

    def chirp(m: int) -> None:
        moments = np.zeros((cells, terms, 2 * width), dtype=real)
        add_moments(
            paths.tx_point, paths.rx_point, paths.tx_velocity, paths.rx_velocity,
            paths.between_m, paths.between_rate_mps, paths.amplitude,
            tx, rx, _centre(tx), _centre(rx), float(start[m]),
            reference_frequency_hz(radar), waveform.bandwidth_hz, waveform.slope_hz_per_s,
            float(waveform.residual_video_phase), OVERSAMPLING, moments,
        )  # fmt: skip
        spectra = scipy.fft.ifft(moments.view(cube.dtype), axis=0, norm="forward", overwrite_x=True)
        first = -(waveform.samples // 2)
        samples = np.arange(first, first + waveform.samples)
        signal = np.einsum("pn,npc->nc", polynomials, spectra[samples])
        part = cube[m][:, block.rx]
        part[:, :, tx_indices] += signal.reshape(waveform.samples, len(tx), len(rx)).transpose(0, 2, 1)

    list(pool.map(chirp, range(len(start))))
