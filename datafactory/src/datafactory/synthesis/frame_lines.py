"""The cube of paths along Doppler lines: spread them, one FFT a line over range, then all chirps of a sample at once.

After :func:`datafactory.synthesis.lines.add_lines` the grid holds a spectrum over range for each line. Its FFT gives
F_l[n]. With eta_m the chirps' positions in the frame and eta' = (1 + nu_n kappa) eta_m, chirp m at sample n is

    s[m, n] = gain(eta') sum_l F_l[n] exp(j 2 pi f_l eta'),

a matrix product of chirps and lines for each sample, whose price does not depend on the number of paths. Chirps at eta
and -eta have conjugate rows: two real products, of cosines and of sines, give both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.fft
from jaxtyping import Complex64, Float32, Float64, Int64
from threadpoolctl import threadpool_limits

from datafactory.synthesis.chirps import range_weights, terms_for
from datafactory.synthesis.lines import Forms, add_lines
from datafactory.synthesis.lines_at_centres import CLOSE_PARTS, Paths, Weights
from datafactory.synthesis.motion import Motion, Part, Recording, centre, motion_of
from datafactory.synthesis.slow_time import (
    LINE_OVERSAMPLING,
    element_reach,
    element_weights,
    line_shape,
)
from datafactory.synthesis.sorting import (
    RANGE_SHARE,
    RANGE_SLACK_BINS,
    VIEW_SHARE,
    PathsAlongLines,
    range_cells,
)
from datafactory.synthesis.spread import LANES, Sensor, columns, padded
from shared.physics.compiled import compiled
from shared.physics.cycles import phasor_like
from shared.physics.vectors import aligned
from shared.signal.sweep import (
    sweep_positions,
)

RANGE_OVERSAMPLING = 1.5
"""Range cells in a bin, about: the FFT's length is the next that factors into small primes. With 2 a path takes two
cells less, and the FFTs a third more."""
GRID_BYTES = 96e6
"""Of the grid that is held at a time; lines beyond it are done in turns."""
SAMPLES_AT_ONCE = 32
"""Whose matrix product is one call."""


@dataclass(frozen=True)
class Job:
    """Paths of a group, as their TX see them.

    :param first: the first line of each, in spacings
    """

    group: PathsAlongLines
    part: Part
    motion: Motion
    anchor: Float64[np.ndarray, " paths"]
    first: Int64[np.ndarray, " paths"]
    cell: Int64[np.ndarray, " paths"]


@dataclass(frozen=True)
class BlockPlan:
    """How paths are spread for a block of RX elements.

    :param rx: of the block
    :param cells: of the range
    :param gain, weights: of the range's shift
    """

    rx: slice
    cells: int
    jobs: list[Job]
    gain: Float32[np.ndarray, " samples"]
    weights: Float32[np.ndarray, "taps terms"]
    recording: Recording


def block_plans(groups: Sequence[PathsAlongLines], recording: Recording) -> Iterator[BlockPlan]:
    """How groups of paths are spread, block by block; all their line weights have one gain."""
    waveform, array = recording.waveform, recording.array
    cells = scipy.fft.next_fast_len(int(np.ceil(RANGE_OVERSAMPLING * waveform.samples)))
    for block in recording.rx_blocks():
        rx = array.rx[block]
        reach = recording.reach_bins(array.tx) + recording.reach_bins(rx)
        reach = float(np.ceil((0.5 * waveform.samples / cells + reach + RANGE_SLACK_BINS) * 1e6) * 1e-6)
        error = RANGE_SHARE * recording.tolerance
        terms = terms_for(reach, 0.8 * error, waveform.samples)
        gain, weights = range_weights(waveform.samples, reach, terms, cells / waveform.samples, error)
        jobs = _jobs(groups, recording, rx, cells)
        yield BlockPlan(block, cells, jobs, gain.astype(np.float32), weights.astype(np.float32), recording)


def add_along_lines(
    cube: Complex64[np.ndarray, "chirps samples rx tx"],
    groups: Sequence[PathsAlongLines],
    recording: Recording,
    threads: int,
) -> None:
    """Add to ``cube`` the paths of groups; all their line weights have one gain.

    :param threads: samples worked on at once
    """
    gain_taps, array = groups[0].weights.gain_taps, recording.array
    for plan in block_plans(groups, recording):
        rx, cells, taps = array.rx[plan.rx], plan.cells, len(plan.weights)
        columns_of = slice(plan.rx.start * len(array.tx), plan.rx.stop * len(array.tx))
        row_bytes = (cells + taps - 1) * len(array.tx) * padded(rx).shape[1] * 8
        for lines, chosen in _turns(plan.jobs, max(int(GRID_BYTES / row_bytes), 1)):
            shape = len(lines), len(array.tx) * padded(rx).shape[1] // LANES, cells + taps - 1, 2, LANES
            grid = aligned(shape, np.float32)
            grid.fill(0.0)
            for job, some in chosen:
                _spread(grid, job, some, lines, plan)
            fast_time = _fast_time(grid, cells, taps, plan.gain, (len(rx), len(array.tx)))
            by_channel = cube.reshape(*cube.shape[:2], -1)[:, :, columns_of]
            _add_chirps(by_channel, fast_time, lines / LINE_OVERSAMPLING, gain_taps, recording, threads)


def _jobs(
    groups: Sequence[PathsAlongLines], recording: Recording, rx: Float64[np.ndarray, "rx 3"], cells: int
) -> list[Job]:
    """The parts of all tables, each path with its lines."""
    waveform, centres, jobs = recording.waveform, (centre(recording.array.tx), centre(rx)), []
    for group in groups:
        weights = group.weights
        for part in recording.parts_of(group.paths, waveform.chirps):
            motion = motion_of(part.paths, centres, float(part.start[waveform.chirps // 2]), recording)
            below = np.floor(motion.doppler * LINE_OVERSAMPLING).astype(np.int64)
            cell = range_cells(part.paths.range_m(), waveform, cells / waveform.samples, cells)
            first = below - weights.taps // 2 + 1
            jobs.append(Job(group, part, motion, (below + 0.5) / LINE_OVERSAMPLING, first, cell))
    return jobs


def _turns(
    jobs: list[Job], most: int
) -> Iterator[tuple[Int64[np.ndarray, " lines"], list[tuple[Job, Int64[np.ndarray, " chosen"]]]]]:
    """Lines in use [spacings], rising, about ``most`` at a time, with the jobs' paths that lie within, in their order.

    Paths are in the order of their lines, then of their range: what they write to stays in cache.
    """
    orders = [np.lexsort((job.cell, job.first)) for job in jobs]
    ends = [0] * len(jobs)
    while any(end < len(order) for end, order in zip(ends, orders, strict=True)):
        start = min(
            int(job.first[order[end]]) for job, order, end in zip(jobs, orders, ends, strict=True) if end < len(order)
        )
        stop = start + max(most, *(job.group.weights.taps for job in jobs))
        used, chosen = np.zeros(stop - start, dtype=bool), []
        for index, (job, order, end) in enumerate(zip(jobs, orders, ends, strict=True)):
            to = end + int(np.searchsorted(job.first[order[end:]], stop - job.group.weights.taps, side="right"))
            ends[index] = to
            if to > end:
                chosen.append((job, order[end:to]))
                for line in np.unique(job.first[order[end:to]] - start):
                    used[line : line + job.group.weights.taps] = True
        yield start + np.flatnonzero(used), chosen


def _spread(
    grid: Float32[np.ndarray, "lines panels cells 2 16"],
    job: Job,
    chosen: Int64[np.ndarray, " chosen"],
    lines: Int64[np.ndarray, " lines"],
    plan: BlockPlan,
) -> None:
    """Add some paths of a job to the grid."""
    recording, array, part, group = plan.recording, plan.recording.array, job.part, job.group
    waveform, rx, line = recording.waveform, array.rx[plan.rx], group.weights
    reach = element_reach(group.terms, VIEW_SHARE * recording.tolerance, recording.half)
    paths = Paths(
        columns(part.paths, chosen), job.anchor[chosen], np.searchsorted(lines, job.first[chosen]),
        np.take(job.motion.bend, chosen, axis=1),
    )  # fmt: skip
    sensor = Sensor(array.tx[part.tx], padded(rx), centre(array.tx), centre(rx), part.tx.start)
    sweep = recording.sweep(plan.cells / waveform.samples, plan.cells, float(part.start[waveform.chirps // 2]))
    weights = Weights(line.node, element_weights(line, reach, group.terms), plan.weights)
    (taps, powers), parts = plan.weights.shape, CLOSE_PARTS if group.close else 1
    forms = Forms(taps, powers, group.orders, group.terms, parts)
    add_lines(paths, sensor, sweep, weights, forms, grid)


def _fast_time(
    grid: Float32[np.ndarray, "lines panels cells 2 16"],
    cells: int,
    taps: int,
    gain: Float32[np.ndarray, " samples"],
    elements: tuple[int, int],
) -> Complex64[np.ndarray, "samples lines channels"]:
    """F_l[n] of every line, channels in their order."""
    samples = len(gain)
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    half = samples // 2
    result = np.empty((samples, len(grid), elements[0] * elements[1]), dtype=np.complex64)
    spectrum = np.empty((cells, *elements), dtype=np.complex64)
    for line, row in enumerate(grid):
        line_spectrum(row, taps // 2, spectrum)
        transformed = scipy.fft.ifft(spectrum.reshape(cells, -1), axis=0, norm="forward")
        np.multiply(transformed[cells - half :], gain[:half, None], out=result[:half, line])
        np.multiply(transformed[: samples - half], gain[half:, None], out=result[half:, line])
    return result


def _add_chirps(
    cube: Complex64[np.ndarray, "chirps samples channels"],
    fast_time: Complex64[np.ndarray, "samples lines channels"],
    frequency: Float64[np.ndarray, " lines"],
    gain_taps: int,
    recording: Recording,
    threads: int,
) -> None:
    """Add all chirps of every sample to ``cube``."""
    waveform = recording.waveform
    scale, half = 1.0 + recording.kappa * sweep_positions(waveform.samples), waveform.chirps // 2 + 1
    shape = line_shape(gain_taps)

    def add(first: int) -> None:
        some = slice(first, min(first + SAMPLES_AT_ONCE, waveform.samples))
        rows = np.empty((some.stop - first, 2, half, len(frequency)), dtype=np.float32)
        fill_lines(frequency, scale[some], waveform.chirps, shape, gain_taps, LINE_OVERSAMPLING, rows)
        product = rows.reshape(len(rows), 2 * half, -1) @ fast_time[some].view(np.float32)
        add_samples(product.reshape(len(rows), 2, half, -1), first, cube)

    with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(threads) as pool:
        list(pool.map(add, range(0, waveform.samples, SAMPLES_AT_ONCE)))


_FAST = {"contract", "nsz", "arcp"}


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def line_spectrum(row, margin, spectrum):
    """One line's grid, folded to cyclic cells, as complex numbers in the channels' order.

    :param row: [TX * panels, cells + 2 * margin, 2, LANES]; what the margins hold belongs to the other end
    :param spectrum: [cells, RX, TX] complex64, overwritten
    """
    cells, rx_count, tx_count = spectrum.shape
    panels, lanes = row.shape[0] // tx_count, row.shape[3]
    for cell in range(cells):
        for panel in range(panels):
            first = panel * lanes
            for i in range(tx_count):
                re, im = row[i * panels + panel, cell + margin, 0], row[i * panels + panel, cell + margin, 1]
                for e in range(min(lanes, rx_count - first)):
                    spectrum[cell, first + e, i] = complex(re[e], im[e])
    for outside in range(margin):
        for source in (outside, cells + margin + outside):
            cell = (source - margin) % cells
            for i in range(tx_count):
                for e in range(rx_count):
                    here = row[i * panels + e // lanes, source]
                    spectrum[cell, e, i] += complex(here[0, e % lanes], here[1, e % lanes])


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def fill_lines(frequency, scale, chirps, shape, taps, oversampling, rows):
    """cos and sin of 2 pi f eta', times the gain, for eta = p / chirps, p = 0, 1, ...

    :param scale: [samples] eta' / eta; ``rows`` [samples, 2, p, lines], overwritten
    """
    for n in range(len(scale)):
        for p in range(rows.shape[2]):
            eta = p / chirps * scale[n]
            width = np.pi * taps * eta / oversampling
            root = np.sqrt(shape * shape - width * width)
            gain = np.sinh(shape) / shape * root / np.sinh(root)
            cosines, sines = rows[n, 0, p], rows[n, 1, p]
            for line in range(len(frequency)):
                cosine, sine = phasor_like(frequency[line] * eta, cosines[line])
                cosines[line] = gain * cosine
                sines[line] = gain * sine


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_samples(product, first, cube):
    """Add samples from ``first`` on to ``cube`` [chirps, samples, channels].

    :param product: [samples, 2, p, 2 * channels] of cosines and of sines, for eta = p / chirps
    """
    chirps, _, channels = cube.shape
    middle = chirps // 2
    for n in range(product.shape[0]):
        for p in range(product.shape[2]):
            even, odd = product[n, 0, p], product[n, 1, p]
            if middle + p < chirps:
                line = cube[middle + p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] - odd[2 * c + 1], even[2 * c + 1] + odd[2 * c])
            if 0 < p <= middle:
                line = cube[middle - p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] + odd[2 * c + 1], even[2 * c + 1] - odd[2 * c])
