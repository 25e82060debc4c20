"""Which kernel a path gets: the cheapest that keeps the tolerance.

* A *standing* path has one delay: one chirp of the exact kernel serves all (:mod:`datafactory.synthesis.chirps`).
* A path that moves almost evenly goes *along lines* (:mod:`datafactory.synthesis.frame_lines`): over the fewest Doppler
  lines that reach what curvature and the elements' different views add to its own Doppler, with the fewest separable
  terms that what couples its range and its Doppler calls for.
* Any other path goes *by chirps*: the exact kernel, chirp after chirp.

A path may change its kernel between frames: each keeps the tolerance, so that no seam is larger than it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.motion import Recording, centre, left_out, motion_of, moving, reach_m
from datafactory.synthesis.slow_time import (
    LINE_OVERSAMPLING,
    MANY_TERMS,
    LineWeights,
    element_reach,
    few_terms,
    line_weights,
)
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.waveform import Waveform

FLOAT32_TOLERANCE = 5e-7
"""Below this the cube is made in complex128: rounding alone is up to 2.7e-7 in complex64, measured with 1e2 to 1e5
paths."""
RANGE_SHARE, LINE_SHARE, BEND_SHARE, VIEW_SHARE = 0.5, 0.4, 0.4, 0.2
"""Of the tolerance, for the range's weights, the lines' weights, what a bent delay leaves and an element's own
Doppler. They are independent: their squares add to 0.61, and rounding has 0.36."""
EXTRAS = (0.1, 0.3, 1.0, 3.0, 8.0)
"""What sets of line weights reach beyond half a spacing [cycles a frame]. On munich at 2.5 m/s the first serves nine
paths of ten."""
LEAST_CHIRPS, LEAST_SAMPLES = 16, 16
"""Shorter frames and sweeps are made chirp by chirp: a path is spread over eight lines and more."""
RANGE_SLACK_BINS = 0.01
"""Room for the mean of a bend in the reach of the range's weights."""
CROWD = 256
"""Largest number of paths in one cell whose sum in float32 keeps 1e-6: with more, the cube is summed in float64. The
error of 1000 equal paths is 5e-6, of 1000 paths of random phase 2e-6."""
CROWD_GROWTH = 100
"""... and for larger tolerances this many for each 1e-6."""


@dataclass(frozen=True)
class PathsAlongLines:
    """Paths that are spread with one set of line weights and the same number of separable terms.

    :param orders: 1 to 3, see :mod:`datafactory.synthesis.lines`
    :param close: whether their elements have a curvature of their own
    :param terms: of the polynomial in an element's own Doppler
    """

    weights: LineWeights
    orders: int
    paths: PathTable
    close: bool
    terms: int


@dataclass(frozen=True)
class SortedPaths:
    """The paths of a table by the kernel they get.

    :param standing: one chirp serves all
    :param lines: in groups that are spread alike
    :param chirps: the exact kernel for every chirp
    """

    standing: PathTable
    lines: tuple[PathsAlongLines, ...]
    chirps: PathTable

    def counts(self) -> dict[str, int]:
        """Paths by kernel, for a manifest."""
        return {
            "paths_standing": len(self.standing),
            "paths_along_lines": sum(len(group.paths) for group in self.lines),
            "paths_by_chirps": len(self.chirps),
        }


def crowd_limit(tolerance: float) -> int:
    """Most paths in a cell that are summed in float32."""
    return max(CROWD, round(CROWD_GROWTH * tolerance / 1e-6))


def line_sets(recording: Recording) -> list[tuple[float, LineWeights]]:
    """The sets of line weights that there are for a tolerance, with what each reaches; narrow to wide."""
    half, error = recording.half, LINE_SHARE * recording.tolerance
    first = line_weights(EXTRAS[0], error, half)
    if first is None:
        return []
    sets = [(extra, line_weights(extra, error, half, first.taps)) for extra in EXTRAS]
    return [(extra, weights) for extra, weights in sets if weights is not None]


def sorted_paths(paths: PathTable, recording: Recording) -> SortedPaths:
    """Sort a table's paths by what they need."""
    waveform = recording.waveform
    short = waveform.chirps < LEAST_CHIRPS or waveform.samples < LEAST_SAMPLES
    sets = [] if short or recording.tolerance < FLOAT32_TOLERANCE else line_sets(recording)
    # A specular path of one TX is a scattered path; the TX differ by less than the reach that is allowed for.
    middle = paths.specular.as_scattered(centre(recording.array.tx))
    scattered = _needs(paths.scattered, sets, recording, specular=False)
    specular = _needs(middle, sets, recording, specular=True)

    def chosen(need: int) -> PathTable:
        return replace(
            paths, scattered=paths.scattered.take(scattered == need), specular=paths.specular.take(specular == need)
        )

    kinds = _kinds(recording)
    wanted = np.union1d(scattered, specular)
    lines = tuple(
        PathsAlongLines(sets[need // FORMS][1], need % ORDERS + 1, chosen(need), *kinds[need % FORMS // ORDERS])
        for need in wanted[(wanted >= 0) & (wanted < BY_CHIRPS)].tolist()
    )
    return SortedPaths(chosen(STANDING), lines, chosen(BY_CHIRPS))


ORDERS = 3
"""Most separable terms."""
MOST_ARE_CLOSE = 1e-4
"""Tolerance below which most paths are close: few terms where they serve take a fifth off the cube's time at 1e-6. At
larger ones they would take nothing off, and add two forms of the kernel, of three seconds each to compile."""
FORMS = 3 * ORDERS
"""Orders of each of :func:`_kinds`, at most."""
STANDING, BY_CHIRPS = -1, FORMS * len(EXTRAS)
"""Needs that are not FORMS times the index of a set of line weights, plus the form."""


def _kinds(recording: Recording) -> tuple[tuple[bool, int], ...]:
    """Whether paths are close, and terms of the polynomial in an element's own Doppler; cheap to dear."""
    few = few_terms(VIEW_SHARE * recording.tolerance, recording.half)
    far, many = (False, few), (True, MANY_TERMS)
    return (far, (True, few), many) if recording.tolerance < MOST_ARE_CLOSE else (far, many)


def _needs(
    paths: ScatteredPaths, sets: list[tuple[float, LineWeights]], recording: Recording, specular: bool
) -> Int64[np.ndarray, " paths"]:
    """What every path needs: STANDING, BY_CHIRPS, or in every block of RX at most these line weights and orders."""
    result = np.full(len(paths), BY_CHIRPS, dtype=np.int64)
    if sets and len(paths):
        radar, array, tolerance = recording.radar, recording.array, recording.tolerance
        start = radar.waveform.chirps // 2 * radar.waveform.chirp_interval_s
        tx_reach, limits = reach_m(array.tx), [limit for limit, _ in sets]
        kinds = [
            (close, element_reach(terms, VIEW_SHARE * tolerance, recording.half)) for close, terms in _kinds(recording)
        ]
        widest, form = np.zeros(len(paths), dtype=np.int64), np.zeros(len(paths), dtype=np.int64)
        crowded = np.zeros(len(paths), dtype=bool)
        for block in recording.rx_blocks():
            rx = array.rx[block]
            # The image of a specular path moves with the TX as far as the TX itself.
            reaches = (0.0, tx_reach + reach_m(rx)) if specular else (tx_reach, reach_m(rx))
            motion = motion_of(paths, (centre(array.tx), centre(rx)), start, recording)
            out = left_out(motion, reaches, recording)
            limit = BEND_SHARE * tolerance - _video_phase_error(motion.doppler, radar)
            kept = np.concatenate(
                [((out.close if close else out.far) <= limit) & (out.view <= reach) for close, reach in kinds]
            )
            kept &= np.abs(motion.bend[1]) <= 12.0 * RANGE_SLACK_BINS
            widest = np.maximum(widest, np.searchsorted(limits, out.extra))
            form = np.maximum(form, np.where(kept.any(axis=0), kept.argmax(axis=0), FORMS))
            crowded |= _crowded(motion.doppler, paths, radar.waveform, crowd_limit(tolerance))
        along = (widest < len(sets)) & (form < FORMS) & ~crowded
        result[along] = (FORMS * widest + form)[along]
    result[~moving(paths)] = STANDING
    return result


def _video_phase_error(doppler: np.ndarray, radar: Radar) -> np.ndarray:
    """Bound on the part of the residual video phase, pi z^2 / (B T_c), that is quadratic in the departure z from a
    cell: half a cell, a block, and the range that the frame adds."""
    waveform = radar.waveform
    if not waveform.residual_video_phase:
        return np.zeros(len(doppler))
    departure = 1.0 + 0.5 * np.abs(doppler) * waveform.bandwidth_hz / waveform.carrier_hz
    return np.pi * departure**2 / (waveform.bandwidth_hz * waveform.chirp_duration_s)


def range_cells(range_m: np.ndarray, waveform: Waveform, oversampling: float, cells: int) -> np.ndarray:
    """[K] range cells, cyclic, of paths of these half lengths [m]."""
    cells_per_metre = oversampling * waveform.bandwidth_hz / SPEED_OF_LIGHT
    return np.floor(2.0 * range_m * cells_per_metre).astype(np.int64) % cells


def _crowded(doppler: np.ndarray, paths: ScatteredPaths, waveform: Waveform, limit: int) -> Bool[np.ndarray, " paths"]:
    """Whether a path stands in a cell of range and Doppler with more paths than ``limit``."""
    if len(paths) <= limit:
        return np.zeros(len(paths), dtype=bool)
    cell = range_cells(paths.range_m(), waveform, 2.0, 2 * waveform.samples)
    line = np.floor(doppler * LINE_OVERSAMPLING).astype(np.int64)
    index = (line - line.min()) * 2 * waveform.samples + cell
    return np.bincount(index)[index] > limit
