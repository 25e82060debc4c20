"""What a setting costs, counted and not timed: the same number on every machine and in every mood of it.

The unit is one multiply-add of the exact kernel's inner loop. Loops are counted as they stand in the kernels, for the
paths as they are sorted. Matrix products, FFTs and the passes over the cube run at other rates; these rates, and that
of a ray's bounce, which the solver hides, were measured once on one core (``tests/benchmarks/counted.py``). Only ratios
matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.knobs import KnobSettings
from datafactory.paths.table import PathTable
from datafactory.synthesis.chirps import OVERSAMPLING, exact_blocks
from datafactory.synthesis.doppler_moments import SHIFT_TERMS
from datafactory.synthesis.frame_lines import block_plans
from datafactory.synthesis.slow_time import FEW_TERMS, MANY_TERMS
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, SortedPaths
from datafactory.synthesis.spread import LANES
from datafactory.synthesis.truth import truth_plan
from shared.radar import Radar
from shared.radar.arrays import AntennaArray

PHASE = 12.0
"""Of one path, instant and element before anything is added up: a length, a phasor, a product."""
VIEW = 30.0
"""Of one path and virtual element of the truth: a length, its rate, a phasor."""
SPREAD = 0.5
"""A multiply-add of the loops along lines, whole vectors: 0.52 us a far path of six lines, 2.7 a close one of ten."""
MOMENT = 0.7
"""A multiply-add of the truth's loop over paths."""
PRODUCT = 0.5
"""A multiply-add of a matrix product."""
TRANSFORM = 2.8
"""A butterfly's share of one number of an FFT."""
PASS = 12.0
"""Reading and writing one complex number of the cube once."""
RAY_BOUNCE = 12_000.0
"""A bounce of a ray: 0.9 s for 2e5 rays of 4 steps on the shipped street, at 1.0e10 multiply-adds a second."""
RAY_PASS = 1.7e9
"""Of a pass of rays, whatever their number, in which the scene is built and the solver's kernels start: 3125 rays take
0.17 s in one pass in munich and 0.44 on the street, 12 500 there 0.66 in three (of one run; docs/accuracy.md).
"""


@dataclass(frozen=True)
class Work:
    """Multiply-adds of one frame.

    :param fixed: whatever the paths
    :param by_paths: of all its paths together
    """

    fixed: float = 0.0
    by_paths: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(self.fixed + other.fixed, self.by_paths + other.by_paths)

    @property
    def total(self) -> float:
        return self.fixed + self.by_paths


def trace_work(settings: KnobSettings) -> float:
    """Multiply-adds for tracing one frame."""
    trace = settings.chain().trace
    passes = 3 if trace.depth > 1 else 1  # beside what is scattered once, mirrors and what is scattered again
    return RAY_PASS * passes + RAY_BOUNCE * settings.rays * trace.steps


def frame_work(settings: KnobSettings, radar: Radar) -> float:
    """Multiply-adds of what a frame needs whatever its paths and its tolerance: range-Doppler spectra and the image."""
    waveform = radar.waveform
    elements, signals = radar.virtual_sensor.channels, float(radar.array.channels * waveform.chirps)
    spectra = TRANSFORM * signals * waveform.samples * math.log2(max(waveform.samples * waveform.chirps, 2))
    image = PRODUCT * 4.0 * waveform.range_bins * elements * radar.grid.bins * settings.truth_terms
    return spectra + image + 3.0 * PASS * signals * waveform.samples


def cube_work(paths: SortedPaths, radar: Radar, tolerance: float, array: AntennaArray, intra_chirp: bool) -> Work:
    """Of the cube of sorted paths."""
    waveform = radar.waveform
    work = Work(fixed=PASS * array.channels * waveform.chirps * waveform.samples)
    if len(paths.chirps):
        work += _exact_work(len(paths.chirps), radar, tolerance, array, waveform.chirps)
    if len(paths.standing):
        work += _exact_work(len(paths.standing), radar, tolerance, array, 1)
    return work + _lines_work(paths, radar, tolerance, array, intra_chirp) if paths.lines else work


def _exact_work(paths: int, radar: Radar, tolerance: float, array: AntennaArray, chirps: int) -> Work:
    """Of the exact kernel: moments of every path, weights of every cell, one FFT a channel."""
    width = 1.0 if tolerance >= FLOAT32_TOLERANCE else 2.0
    cells, work = OVERSAMPLING * radar.waveform.samples, Work()
    for elements, _, weights in exact_blocks(array, radar.waveform, tolerance):
        taps, terms = weights.shape
        signals = width * len(array.tx_m) * _padded(elements.stop - elements.start) * chirps
        grid = 2.0 * cells * taps * terms + TRANSFORM * cells * math.log2(cells)
        work += Work(signals * grid, signals * paths * (PHASE + 2.0 * terms))
    return work


def _lines_work(paths: SortedPaths, radar: Radar, tolerance: float, array: AntennaArray, intra_chirp: bool) -> Work:
    """Of the kernel along lines: weights of every path, FFTs of every line, a product of every sample."""
    waveform, work = radar.waveform, Work()
    for plan in block_plans(paths.lines, radar, array, tolerance, intra_chirp):
        (taps, terms), elements = plan.weights.shape, len(array.rx_m[plan.rx])
        channels, by_paths = len(array.tx_m) * elements, 0.0
        for job in plan.jobs:
            orders, lines_of = job.group.orders, job.group.weights.taps
            polynomial = 8.0 * MANY_TERMS if job.group.close else 2.0 * FEW_TERMS
            lanes = _padded(elements) * (job.part.tx.stop - job.part.tx.start)
            one = PHASE * _padded(elements) + lanes * orders * (
                taps * (terms - 1) + lines_of * (polynomial + 4.0 + 2.0 * taps)
            )
            by_paths += SPREAD * one * len(job.first)
        lines, half = len(plan.lines()), waveform.chirps // 2 + 1
        fixed = TRANSFORM * lines * channels * plan.cells * math.log2(plan.cells)
        fixed += PRODUCT * waveform.samples * 2.0 * half * lines * 2.0 * channels
        fixed += PHASE * waveform.samples * half * lines + PASS * channels * waveform.chirps * waveform.samples
        work += Work(fixed, by_paths)
    return work


def truth_work(paths: PathTable, radar: Radar, cells: NDArray[np.int64], terms: int, intra_chirp: bool) -> Work:
    """Of the truth's moments: what elements see of paths, their moments in the cells in which they are seen, rows."""
    _, path_terms, seen = truth_plan(paths, radar, cells, terms, intra_chirp)
    elements, by_paths, fixed = radar.virtual_sensor.channels, 0.0, 0.0
    # What an element sees, the Doppler polynomial by Horner's rule, its product with the echo, powers of the range.
    of_terms = VIEW + path_terms * (path_terms + 1.0) + path_terms * (6.0 + 4.0 * SHIFT_TERMS)
    for cell in seen:
        by_paths += MOMENT * float(of_terms[cell.chosen].sum())
        fixed += PRODUCT * len(cell.rows) * 2.0 * cell.mixing.size + 2.0 * SHIFT_TERMS * float(cell.needed.sum())
    return Work(elements * fixed, elements * by_paths)


def _padded(elements: int) -> int:
    """Elements as the loops have them, a multiple of LANES."""
    return -(-elements // LANES) * LANES
