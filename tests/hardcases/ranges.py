"""Hard cases of distance: at the array, next to it, at the last range bin and beyond.

References are the float64 sum of eq. (1) and the exact matched filter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import (
    cube_error,
    frame_of,
    not_finite,
    points,
    small_radar,
)
from oracles import peak_error_db, truth_rows

from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import near_field_images
from shared.signal.spectrum import range_doppler, select_doppler


def _near(position: Sequence[float]) -> float:
    """Error of the cube of a scatterer next to the array; infinite if its frame holds anything not finite."""
    paths, radar = points([position]), small_radar()
    return np.inf if not_finite(frame_of(paths, radar)) else cube_error(paths, radar)


def _last_range_bin_db() -> float:
    """Largest error [dB] of the truth's first and last rows for an echo in the last range bin."""
    radar = small_radar(chirps=4)
    last = radar.waveform.range_bins - 1
    # The last range that ``within`` lets pass is that of the unambiguous range, half a bin on.
    range_m, u = (last + 0.3) * radar.waveform.range_step_m, float(radar.grid.u[18])
    paths = points([[range_m * np.sqrt(1.0 - u**2), range_m * u, 0.0]])
    cells = select_doppler(range_doppler(cube_of_paths(paths, radar).astype(np.complex64), radar), 0.0).cells[0]
    rows = [0, 1, last - 1, last]
    images = near_field_images(truth_moments(paths, radar, cells)[None], radar, radar.virtual_sensor)[0]
    return peak_error_db(images[rows], truth_rows(paths, radar, cells, rows))


def _beyond_range() -> float:
    """Echoes beyond the unambiguous range that a scene frame keeps or does not count, and the error of folding them."""
    radar = small_radar()
    far = points([[1.5 * radar.waveform.unambiguous_range_m, 2.0, 0.0], [10.0, 0.0, 0.0]])
    kept = far.within(radar)
    miscounted = abs(len(kept) - 1) + abs(kept.counts["beyond_range"] - 1)
    return np.inf if miscounted else cube_error(far, radar)


def _same_point() -> float:
    """Error of the cube of an array whose TX and RX coincide, with a scatterer on that very point beside another."""
    radar = small_radar()
    there = line(np.array([0.0, 0.03]))
    radar = radar.model_copy(update={"array": AntennaArray(tx_m=there, rx_m=there)})
    paths = points([[0.0, 0.03, 0.0], [12.0, 3.0, 0.0]])
    return np.inf if not_finite(frame_of(paths, radar)) else cube_error(paths, radar)


CASES = (
    HardCase("scatterer at 1 cm", "1 / R^2, near field of one element", 1e-6, "relative",
             lambda: _near([0.01, 0.0, 0.0])),
    HardCase("scatterer on an RX element", "a leg of length 0", 1e-6, "relative", lambda: _near([0.0, -0.045, 0.0])),
    HardCase("TX and RX at one point", "a round trip of 0", 1e-6, "relative", _same_point),
    HardCase("echo in the last range bin", "neighbours wrap round", -60.0, "dB", _last_range_bin_db),
    HardCase("echo beyond the unambiguous range", "folds silently", 1e-6, "relative", _beyond_range),
)  # fmt: skip
