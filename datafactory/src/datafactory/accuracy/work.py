"""What a setting costs, counted and not timed: the same number on every machine and in every mood of it.

The unit is one multiply-add of the cube's inner loop. Loops over paths are counted as they stand in the kernels; a
ray's bounce, which the solver hides, was compared with them once (trace and cube of a street on one core). Only ratios
matter.
"""

from __future__ import annotations

import math
from functools import lru_cache

from datafactory.accuracy.knobs import KnobSettings
from datafactory.synthesis.chirps import OVERSAMPLING, terms_for
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE
from shared.radar import Radar

PHASE = 12.0
"""Of one path, chirp and channel before its moments: phasors multiplied, remainder, amplitude."""
RAY_BOUNCE = 2600.0
"""A bounce of a ray took as long as this many multiply-adds of the cube (0.3 s for 2e5 rays of 2 bounces)."""
TRUTH_PATH = 650.0
"""Of one path and virtual element: a phasor and some twenty moments of range and Doppler."""
TRUTH_ROW = 4_000.0
"""Of one image row, virtual element and term: the cells around the row, real and imaginary parts."""
CUBE_REACH_BINS = 0.6
"""Typical range remainder [bins] of a block of channels, which sets the cube's number of moments."""


def trace_work(settings: KnobSettings) -> float:
    """Multiply-adds for tracing one frame."""
    return RAY_BOUNCE * settings.rays * settings.chain().trace.steps


def counted_work(settings: KnobSettings, paths: float, radar: Radar) -> float:
    """Multiply-adds for one frame with this many paths after pruning."""
    waveform, grid = radar.waveform, radar.grid
    elements = radar.virtual_sensor.channels
    terms = _terms(settings.tolerance)
    width = 1.0 if settings.tolerance >= FLOAT32_TOLERANCE else 2.0
    signals = float(radar.array.channels * waveform.chirps)
    cells = OVERSAMPLING * waveform.samples
    spread = width * signals * paths * (PHASE + 2.0 * terms)
    transforms = width * signals * terms * (4.0 * cells * math.log2(cells) + 4.0 * waveform.samples)
    doppler = 4.0 * signals * waveform.samples * math.log2(waveform.samples * waveform.chirps)
    truth = elements * (TRUTH_PATH * paths + TRUTH_ROW * waveform.range_bins * settings.truth_terms)
    image = 4.0 * waveform.range_bins * elements * grid.bins * settings.truth_terms
    return trace_work(settings) + spread + transforms + doppler + truth + image


@lru_cache(maxsize=64)
def _terms(tolerance: float) -> int:
    """Moments of the cube; thousands of combinations share a few tolerances."""
    return terms_for(CUBE_REACH_BINS, tolerance)
