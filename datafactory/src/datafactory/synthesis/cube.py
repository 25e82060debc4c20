"""PathTable to radar cube: the IF signal of eq. (1)-(2) for every chirp, sample and channel."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from math import factorial

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Float64, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.spread import add_moments, add_to_grid, columns, empty_moments, padded
from datafactory.synthesis.wave_model import EQUATION_1, WaveModel
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal import chirp_times
from shared.signal.sweep import (
    reference_frequency_hz,
    shift_error_rms,
    shift_weights,
    shift_weights_error,
    sweep_positions,
)

OVERSAMPLING = 2
"""Range cells in a bin. With 2 the remainder is half as wide as with 1 and needs fewer moments, for twice the FFT."""
FLOAT32_TOLERANCE = 5e-7
"""Below this the cube is made in complex128: rounding alone is up to 2.7e-7 in complex64, measured with 1e2 to 1e5
paths."""
SMALLEST_TOLERANCE = 1e-11
"""The rounding of phases of 1e5 cycles in float64."""
APPROXIMATION = 0.8
"""Share of the tolerance for the weights' error; rounding, independent of it, has 0.6: 0.8^2 + 0.6^2 = 1."""
BLOCK_REACH_BINS = 0.205
"""Largest difference between a block's delays and the delay of its centre [bins]: blocks of 64 of the virtual sensor's
RX, which need 8 moments at 1e-6."""

FLOAT32_PATHS_PER_CELL = 256
"""Largest number of paths in one range cell whose sum in float32 keeps 1e-6; with more, the cube is summed in float64.
The error of 1000 equal paths is 5e-6, of 1000 paths of random phase 2e-6."""


@dataclass(frozen=True)
class _Contribution:
    """Paths, sorted by range, with the TX they serve and the starts of that TX's chirps [s].

    :param table: of :func:`datafactory.synthesis.spread.columns`
    """

    table: Float64[np.ndarray, "16 paths"]
    tx: slice
    start: Float64[np.ndarray, " chirps"]


@dataclass(frozen=True)
class _Block:
    """RX elements worked on together, and the weights that their delays need.

    :param rx: indices
    :param gain: over the FFT's output
    :param weights: complex where there is a residual video phase
    """

    rx: slice
    gain: Float[np.ndarray, " samples"]
    weights: Float[np.ndarray, "taps terms"] | Complex[np.ndarray, "taps terms"]


def cube_of_paths(
    paths: PathTable,
    radar: Radar,
    tolerance: float = 1e-6,
    array: AntennaArray | None = None,
    threads: int = 1,
    model: WaveModel = EQUATION_1,
) -> Complex[np.ndarray, "chirps samples channels"]:
    """Noise-free IF signal of illuminated paths (amplitudes in sqrt(W)).

    :param tolerance: bound on the relative L2 error against the float64 sum; complex64 down to 5e-7, else complex128
    :param array: another array than the radar's own, e.g. its virtual sensor
    :param threads: chirps worked on at once
    :param model: what the bound is against; the default is eq. (1) and (2)
    :raises ValueError: a tolerance below 1e-11
    """
    if not tolerance >= SMALLEST_TOLERANCE:
        raise ValueError(f"tolerance {tolerance:g}; expected at least {SMALLEST_TOLERANCE:g}")
    array = array or radar.array
    waveform = radar.waveform
    single = tolerance >= FLOAT32_TOLERANCE
    dtype = (
        np.complex64 if single and _most_paths_in_a_cell(paths, waveform) <= FLOAT32_PATHS_PER_CELL else np.complex128
    )
    static = not paths.moves()
    computed = 1 if static else waveform.chirps
    cube = np.zeros((computed, waveform.samples, len(array.rx_m), len(array.tx_m)), dtype=dtype)
    times = chirp_times(radar.model_copy(update={"array": array}))[:, :computed]
    contributions = _contributions(paths, array, times, waveform, plane=not model.near_field)
    if contributions:
        blocks = _blocks(array, waveform, tolerance, dtype)
        tasks = [(block, chirp) for block in blocks for chirp in range(computed)]
        work = partial(_add_chirps, cube, contributions, radar, array, model)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, [tasks[first::threads] for first in range(threads)]))
    channels = cube.reshape(computed, waveform.samples, array.channels)
    channels = channels.astype(np.complex64, copy=False) if single else channels
    return np.repeat(channels, waveform.chirps, axis=0) if static and waveform.chirps > 1 else channels


def _contributions(
    paths: PathTable, array: AntennaArray, times: Float64[np.ndarray, "tx chirps"], waveform: Waveform, plane: bool
) -> list[_Contribution]:
    """Parts of the table: all TX at once where delays factorise, else each TX alone; ``plane`` waves or spherical."""
    all_tx = range(len(array.tx_m))
    parts = []
    if len(paths.scattered):
        scattered = _by_cell(paths.scattered, waveform)
        if np.all(times == times[0]):
            parts.append(_Contribution(scattered, slice(0, len(all_tx)), times[0]))
        else:  # TDM: the targets have moved on when the next TX sends
            parts += [_Contribution(scattered, slice(i, i + 1), times[i]) for i in all_tx]
    if len(paths.specular):
        for i in all_tx:
            specular = _by_cell(paths.specular.as_scattered(array.tx[i], plane), waveform)
            parts.append(_Contribution(specular, slice(i, i + 1), times[i]))
    return parts


def _cells(range_m: Float64[np.ndarray, " paths"], waveform: Waveform) -> Int64[np.ndarray, " paths"]:
    """Range cells of paths of these half lengths [m]."""
    cells_per_metre = OVERSAMPLING * waveform.bandwidth_hz / SPEED_OF_LIGHT
    return np.floor(2.0 * range_m * cells_per_metre).astype(np.int64) % (OVERSAMPLING * waveform.samples)


def _most_paths_in_a_cell(paths: PathTable, waveform: Waveform) -> int:
    """Paths in the fullest range cell."""
    range_m = np.concatenate([paths.scattered.range_m(), paths.specular.range_m()])
    return int(np.bincount(_cells(range_m, waveform)).max(initial=0))


def _by_cell(paths: ScatteredPaths, waveform: Waveform) -> Float64[np.ndarray, "16 paths"]:
    """Table of the paths in the order of their range cells, seen from the origin at t = 0."""
    cells = OVERSAMPLING * waveform.samples
    cell = _cells(paths.range_m(), waveform)
    # NumPy sorts integers of 16 bits by radix, in a twentieth of the time that sorting the ranges takes.
    order = np.argsort(cell.astype(np.min_scalar_type(cells)), kind="stable")
    return columns(paths, order)


def _blocks(array: AntennaArray, waveform: Waveform, tolerance: float, dtype: type) -> list[_Block]:
    """RX in their order, cut so that no block is wider than BLOCK_REACH_BINS to either side of its centre."""
    rx = array.rx
    blocks, first = [], 0
    for last in range(1, len(rx) + 1):
        if last == len(rx) or _reach(rx[first : last + 1], waveform.bandwidth_hz) > BLOCK_REACH_BINS:
            elements = slice(first, last)
            reach = sum(_reach(part, waveform.bandwidth_hz) for part in (array.tx, rx[elements]))
            # Rounded up: blocks of one width differ in the last digits alone, and then share their weights.
            reach = float(np.ceil((0.5 / OVERSAMPLING + reach) * 1e6) * 1e-6)
            gain, weights = _weights(waveform, reach, tolerance)
            real = np.finfo(dtype).dtype
            narrow = dtype if np.iscomplexobj(weights) else real
            blocks.append(_Block(elements, gain.astype(real), weights.astype(narrow)))
            first = last
    return blocks


def _reach(elements: Float64[np.ndarray, "elements 3"], bandwidth_hz: float) -> float:
    """Largest distance from the elements' centre, as a delay in range bins."""
    return float(np.linalg.norm(elements - _centre(elements), axis=1).max()) * bandwidth_hz / SPEED_OF_LIGHT


def _centre(elements: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, " 3"]:
    return 0.5 * (elements.min(axis=0) + elements.max(axis=0))


def terms_for(reach_bins: float, tolerance: float, samples: int = 1024) -> int:
    """Least even number of moments whose mean error over the sweep stays below its share of the tolerance.

    Even numbers alone, because a kernel is compiled for every number. With few samples the sweep's ends weigh more, and
    more moments may be needed.
    """
    nu, terms = sweep_positions(samples), 2
    while shift_error_rms(nu, reach_bins, terms) > APPROXIMATION * tolerance:
        terms += 2
    return terms


@lru_cache(maxsize=8)
def _weights(
    waveform: Waveform, reach: float, tolerance: float
) -> tuple[Float64[np.ndarray, " samples"], Float64[np.ndarray, "taps terms"] | Complex[np.ndarray, "taps terms"]]:
    """Gain and weights of the waveform: with the fewest moments for the tolerance, then with the fewest taps."""
    nu, taps = sweep_positions(waveform.samples), 3
    terms = terms_for(reach, tolerance, waveform.samples)
    if waveform.residual_video_phase:
        # The first power of z^2 that the weights would leave out, see _with_video_phase.
        turn = np.pi * reach**2 / (waveform.bandwidth_hz * waveform.chirp_duration_s)
        while turn ** (terms // 2) / factorial(terms // 2) > APPROXIMATION * tolerance:
            terms += 2
    gain, weights = shift_weights(nu, reach, terms, taps, OVERSAMPLING)
    while shift_weights_error(nu, reach, gain, weights, OVERSAMPLING) > APPROXIMATION * tolerance:
        taps += 2
        gain, weights = shift_weights(nu, reach, terms, taps, OVERSAMPLING)
    if waveform.residual_video_phase:
        return gain, _with_video_phase(weights, waveform.bandwidth_hz * waveform.chirp_duration_s)
    return gain, weights


def _with_video_phase(
    weights: Float64[np.ndarray, "taps terms"], time_bandwidth: float
) -> Complex[np.ndarray, "taps terms"]:
    """Weights of powers of z times exp(-j pi z^2 / (B T_c)): the remainder's residual video phase -mu (z / B)^2 / 2."""
    result = weights.astype(np.complex128)
    factor = 1.0 + 0.0j
    for power in range(1, (weights.shape[1] + 1) // 2):
        factor *= -1j * np.pi / (time_bandwidth * power)
        result[:, 2 * power :] += factor * weights[:, : -2 * power]
    return result


def _add_chirps(
    cube: Complex[np.ndarray, "chirps samples rx tx"],
    contributions: list[_Contribution],
    radar: Radar,
    array: AntennaArray,
    model: WaveModel,
    tasks: list[tuple[_Block, int]],
) -> None:
    """Fill ``cube`` at these blocks of RX and chirps."""
    waveform, tx, tx_centre = radar.waveform, array.tx, _centre(array.tx)
    cells, real = OVERSAMPLING * waveform.samples, cube.real.dtype
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    outputs = np.arange(waveform.samples) - waveform.samples // 2
    workspaces: dict[tuple[int, ...], np.ndarray] = {}
    for block, chirp in tasks:
        rx, powers = array.rx[block.rx], (0,) * block.weights.shape[1]
        shape = cells, len(tx), len(rx), len(powers)
        if shape not in workspaces:
            workspaces[shape] = empty_moments(*shape, real)
        moments = workspaces[shape]
        moments.fill(0.0)
        for part in contributions:
            start = float(part.start[chirp])
            add_moments(
                part.table, tx[part.tx], padded(rx), tx_centre, _centre(rx),
                model.phase_time_s(start, radar), model.beat_time_s(start, radar), not model.near_field,
                reference_frequency_hz(radar), waveform.bandwidth_hz, waveform.slope_hz_per_s,
                float(waveform.residual_video_phase), OVERSAMPLING, powers, part.tx.start, moments,
            )  # fmt: skip
        grid = np.zeros((cells, len(rx), len(tx)), dtype=cube.dtype)
        add_to_grid(moments, np.ascontiguousarray(block.weights.real), powers, cube.dtype.type(1.0), grid)
        if np.iscomplexobj(block.weights):
            add_to_grid(moments, np.ascontiguousarray(block.weights.imag), powers, cube.dtype.type(1.0j), grid)
        spectra = scipy.fft.ifft(grid, axis=0, norm="forward", overwrite_x=True)
        np.multiply(spectra[outputs], block.gain[:, None, None], out=cube[chirp][:, block.rx])
