"""Hard cases of the cube's kernels: crowds that move, near and fast echoes, turns of the TX, the virtual sensors.

The reference is the float64 sum of eq. (1), on some channels and chirps where all of them would take long.
"""

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import points, small_radar
from oracles import if_chirp

from datafactory.paths.table import PathTable
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import sorted_paths
from shared.radar import Radar, load_radar
from shared.radar.arrays import AntennaArray

CROWD = 100_000
CHECKED = 4
"""Channels and chirps, seeded, on which the float64 sum is taken."""


def _sampled_error(paths: PathTable, radar: Radar, tolerance: float, array: AntennaArray | None = None) -> float:
    """Relative L2 error of the cube on CHECKED channels and chirps; infinite if no path goes along Doppler lines."""
    radar = radar if array is None else radar.model_copy(update={"array": array})
    if not sorted_paths(paths, Recording(radar, tolerance, intra_chirp=False)).counts()["paths_along_lines"]:
        return np.inf
    return _error(paths, radar, tolerance, radar.array)


def _error(paths: PathTable, radar: Radar, tolerance: float, array: AntennaArray) -> float:
    cube = cube_of_paths(paths, radar, tolerance, array=array)
    generator, difference, scale = np.random.default_rng(9), 0.0, 0.0
    for _ in range(CHECKED):
        tx, rx = int(generator.integers(len(array.tx_m))), int(generator.integers(len(array.rx_m)))
        chirp = int(generator.integers(radar.waveform.chirps))
        expected = if_chirp(paths, radar, array, (tx, rx), chirp)
        difference += float(np.sum(np.abs(cube[chirp, :, len(array.tx_m) * rx + tx] - expected) ** 2))
        scale += float(np.sum(np.abs(expected) ** 2))
    return float(np.sqrt(difference / scale))


def _moving_crowd(tolerance: float, alike: bool) -> float:
    """Error of the cube of 100 000 moving echoes of one range cell and Doppler line, of one phase or of any."""
    radar, generator = small_radar(samples=32), np.random.default_rng(8)
    spread = 0.0 if alike else 0.02
    place = np.array([12.0, 2.0, 0.0]) + generator.uniform(-spread, spread, (CROWD, 3))
    paths = points(place, np.tile([1.0, 0.5, 0.0], (CROWD, 1)), generator.uniform(0.5, 1.0, CROWD))
    # At 1e-6 such a crowd is not left to float32 sums.
    error = _error if tolerance < 1e-5 else _sampled_error
    return error(paths, radar, tolerance, radar.array)


def _any_motion(tolerance: float, array: AntennaArray | None = None, **waveform: object) -> float:
    """Error of echoes from 0.5 m to twice the unambiguous range, 0 to 40 m/s, within 128 chirps of the default's."""
    radar = small_radar(samples=64, chirps=128, chirp_interval_s=80.6e-6, **waveform)
    generator, count = np.random.default_rng(10), 60
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    farthest = 2.0 * radar.waveform.unambiguous_range_m
    range_m = np.exp(generator.uniform(np.log(0.5), np.log(farthest), count))
    heading = generator.normal(size=(count, 3))
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    speed = generator.uniform(0.0, 40.0, count)
    return _sampled_error(points(range_m[:, None] * direction, speed[:, None] * heading), radar, tolerance, array)


CASES = (
    HardCase("100 000 moving paths in one cell, Doppler lines", "float32 running sums lose digits", 1e-3, "relative",
             lambda: _moving_crowd(1e-3, alike=False)),
    HardCase("100 000 moving paths of one phase, Doppler lines", "rounding errors of one sign add up", 1e-3, "relative",
             lambda: _moving_crowd(1e-3, alike=True)),
    HardCase("100 000 moving paths in one cell, 1e-6", "the crowd must leave the float32 kernel", 1e-6, "relative",
             lambda: _moving_crowd(1e-6, alike=False)),
    *(
        HardCase(f"0.5 m to twice the range, 0 to 40 m/s, {what}, {tolerance:g}",
                 "the kernels meet within one frame: standing, along lines of 1 to 3 orders, by chirps", tolerance,
                 "relative", measure)
        for tolerance in (1e-3, 1e-4, 1e-6)
        for what, measure in (
            ("simultaneous", lambda tolerance=tolerance: _any_motion(tolerance)),
            ("TDM", lambda tolerance=tolerance: _any_motion(tolerance, multiplexing="tdm")),
            ("256 elements of the truth", lambda tolerance=tolerance: _any_motion(tolerance, Radar().virtual_sensor)),
            ("192 channels of a cascade",
             lambda tolerance=tolerance: _any_motion(tolerance, load_radar("mmwcas").array)),
        )
    ),
    # At tighter tolerances the residual video phase sends all that moves to the exact kernel.
    HardCase("0.5 m to twice the range, 0 to 40 m/s, residual video phase, 0.001", "a phase quadratic in the delay",
             1e-3, "relative", lambda: _any_motion(1e-3, residual_video_phase=True)),
)  # fmt: skip
