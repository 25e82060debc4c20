"""The exact kernel: the IF signal chirp after chirp, every delay evaluated for every TX, RX and chirp."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from math import factorial

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float64
from numpy.typing import NDArray

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.motion import Part, Recording, centre
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, crowd_limit, range_cells
from datafactory.synthesis.spread import Sensor, add_moments, add_to_grid, columns, empty_moments, padded
from shared.radar.waveform import Waveform
from shared.signal.sweep import (
    shift_error_rms,
    shift_weights,
    shift_weights_error,
    sweep_positions,
)

OVERSAMPLING = 2
"""Range cells in a bin. With 2 the remainder is half as wide as with 1 and needs fewer moments, for twice the FFT."""
APPROXIMATION = 0.8
"""Share of the tolerance for the weights' error; rounding, independent of it, has 0.6: 0.8^2 + 0.6^2 = 1."""


def cube_by_chirps(
    paths: PathTable, recording: Recording, threads: int, chirps: int, dtype: type
) -> Complex[np.ndarray, "{chirps} samples rx tx"]:
    """The first chirps of the IF signal.

    :param threads: chirps worked on at once
    :param dtype: np.complex64 or np.complex128
    """
    waveform, array = recording.waveform, recording.array
    cube: NDArray = np.zeros((chirps, waveform.samples, len(array.rx_m), len(array.tx_m)), dtype=dtype)
    parts = [(_by_cell(part.paths, waveform), part) for part in recording.parts_of(paths, chirps)]
    if parts:
        tasks = [(block, chirp) for block in exact_blocks(recording) for chirp in range(chirps)]
        work = partial(_add_chirps, cube, parts, recording)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, [tasks[first::threads] for first in range(threads)]))
    return cube


def precision(tables: Sequence[PathTable], waveform: Waveform, tolerance: float) -> type:
    """Of the sums over all tables: np.complex64, or np.complex128 for small tolerances and where the fullest range cell
    is crowded."""
    cells = OVERSAMPLING * waveform.samples
    lengths = [part.range_m() for paths in tables for part in (paths.scattered, paths.specular)]
    parts = [range_cells(length, waveform, OVERSAMPLING, cells) for length in lengths]
    crowded = int(np.bincount(np.concatenate(parts)).max(initial=0)) > crowd_limit(tolerance)
    return np.complex128 if crowded or tolerance < FLOAT32_TOLERANCE else np.complex64


def _by_cell(paths: ScatteredPaths, waveform: Waveform) -> Float64[np.ndarray, "16 paths"]:
    """Table of the paths in the order of their range cells, seen from the origin at t = 0."""
    cells = OVERSAMPLING * waveform.samples
    cell = range_cells(paths.range_m(), waveform, OVERSAMPLING, cells)
    # NumPy sorts integers of 16 bits by radix, in a twentieth of the time that sorting the ranges takes.
    order = np.argsort(cell.astype(np.min_scalar_type(cells)), kind="stable")
    return columns(paths, order)


Block = tuple[slice, Float64[np.ndarray, " samples"], NDArray]
"""RX elements worked on together, the gain over the FFT's output [samples], and the weights that their delays need
[taps, terms], complex where there is a residual video phase."""


def exact_blocks(recording: Recording) -> list[Block]:
    """The blocks of an array."""
    blocks = []
    for elements in recording.rx_blocks():
        reach = recording.reach_bins(recording.array.tx) + recording.reach_bins(recording.array.rx[elements])
        # Rounded up: blocks of one width differ in the last digits alone, and then share their weights.
        reach = float(np.ceil((0.5 / OVERSAMPLING + reach) * 1e6) * 1e-6)
        blocks.append((elements, *_weights(recording.waveform, reach, recording.tolerance)))
    return blocks


@lru_cache(maxsize=64)
def terms_for(reach_bins: float, error: float, samples: int) -> int:
    """Least even number of moments whose mean error over the sweep stays below ``error``.

    Even numbers alone, because a kernel is compiled for every number. With few samples the sweep's ends weigh more, and
    more moments may be needed.
    """
    nu, terms = sweep_positions(samples), 2
    while shift_error_rms(nu, reach_bins, terms) > error:
        terms += 2
    return terms


@lru_cache(maxsize=16)
def range_weights(
    samples: int, reach_bins: float, terms: int, oversampling: float, error: float
) -> tuple[Float64[np.ndarray, " samples"], Float64[np.ndarray, "taps terms"]]:
    """Gain and weights of the range's shift from so many moments, with the fewest taps that keep ``error``."""
    nu, taps = sweep_positions(samples), 3
    gain, weights = shift_weights(nu, reach_bins, terms, taps, oversampling)
    while shift_weights_error(nu, reach_bins, gain, weights, oversampling) > error:
        taps += 2
        gain, weights = shift_weights(nu, reach_bins, terms, taps, oversampling)
    return gain, weights


def _weights(
    waveform: Waveform, reach: float, tolerance: float
) -> tuple[Float64[np.ndarray, " samples"], Float64[np.ndarray, "taps terms"] | Complex[np.ndarray, "taps terms"]]:
    """Gain and weights of the waveform: with the fewest moments for the tolerance, then with the fewest taps."""
    error = APPROXIMATION * tolerance
    terms = terms_for(reach, error, waveform.samples)
    if waveform.residual_video_phase:
        # The first power of z^2 that the weights would leave out, see _with_video_phase.
        turn = np.pi * reach**2 / (waveform.bandwidth_hz * waveform.chirp_duration_s)
        while turn ** (terms // 2) / factorial(terms // 2) > error:
            terms += 2
    gain, weights = range_weights(waveform.samples, reach, terms, OVERSAMPLING, error)
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
    parts: list[tuple[Float64[np.ndarray, "16 paths"], Part]],
    recording: Recording,
    tasks: list[tuple[Block, int]],
) -> None:
    """Fill ``cube`` at these blocks of RX and chirps.

    :param parts: with their paths sorted by range, as the kernel reads them
    """
    waveform, array = recording.waveform, recording.array
    tx, tx_centre = array.tx, centre(array.tx)
    cells, real = OVERSAMPLING * waveform.samples, cube.real.dtype
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    outputs = np.arange(waveform.samples) - waveform.samples // 2
    workspaces: dict[tuple[int, ...], np.ndarray] = {}
    for (elements, gain, weights), chirp in tasks:
        rx, powers = array.rx[elements], (0,) * weights.shape[1]
        shape = cells, len(tx), len(rx), len(powers)
        if shape not in workspaces:
            workspaces[shape] = empty_moments(*shape, real)
            workspaces[shape].fill(0.0)
        moments, used = workspaces[shape], np.zeros(cells, dtype=np.bool_)
        for table, part in parts:
            sensor = Sensor(tx[part.tx], padded(rx), tx_centre, centre(rx), part.tx.start)
            sweep = recording.sweep(OVERSAMPLING, cells, float(part.start[chirp]))
            add_moments(table, sensor, sweep, powers, moments, used)
        grid = np.zeros((cells, len(rx), len(tx)), dtype=cube.dtype)
        add_to_grid(moments, used, weights.real.astype(real, order="C"), powers, cube.dtype.type(1.0), grid)
        if np.iscomplexobj(weights):
            add_to_grid(moments, used, weights.imag.astype(real, order="C"), powers, cube.dtype.type(1.0j), grid)
        moments[used] = 0.0
        spectra = scipy.fft.ifft(grid, axis=0, norm="forward", overwrite_x=True)
        np.multiply(spectra[outputs], gain[:, None, None].astype(real), out=cube[chirp][:, elements])
