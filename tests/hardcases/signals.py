"""Hard cases of the IF signal: dynamic range, cancellation, path counts from zero to 100 000, ambiguities, shapes.

The reference is the float64 sum of eq. (1) (``tests/oracles.py``).
"""

from collections.abc import Sequence

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import cube_error, frame_of, not_finite, points, small_radar
from oracles import if_cube, peak_error_db, truth_rows

from datafactory.paths.table import PathTable
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import delay_and_sum, near_field_images
from shared.signal.spectrum import range_doppler, select_doppler

WEAK = 1e-6
"""An echo 120 dB below its neighbour."""


def _monostatic(radar: Radar) -> Radar:
    """The same radar with one TX and one RX, both at the origin."""
    origin = line(np.zeros(1))
    return radar.model_copy(update={"array": AntennaArray(tx_m=origin, rx_m=origin)})


def _weak_echo_error(separation_m: float) -> float:
    """Error relative to the weak one of two echoes, in the cube of tolerance 1e-9."""
    radar = small_radar()
    both = points([[12.0, 1.0, 0.0], [12.0 + separation_m, 1.0, 0.0]], amplitude=[1.0, WEAK])
    weak = both.scattered.take(np.array([1]))
    error = cube_of_paths(both, radar, tolerance=1e-9) - if_cube(both, radar)
    return float(np.linalg.norm(error) / np.linalg.norm(if_cube(PathTable(weak), radar)))


def _weak_echo_level_db() -> float:
    """Error of the level that an echo 120 dB down reads in the range-Doppler spectrum, 60 bins from a strong one.

    Both stand on the grid, where the Hann window of the other is zero: what is left is the arithmetic, complex64.
    """
    radar = _monostatic(small_radar())
    step = radar.waveform.range_step_m
    paths = points([[20 * step, 0.0, 0.0], [80 * step, 0.0, 0.0]], amplitude=[1.0, WEAK])
    spectrum = range_doppler(cube_of_paths(paths, radar).astype(np.complex64), radar)
    read = np.abs(spectrum[80, radar.waveform.chirps // 2]).max()
    return abs(float(20.0 * np.log10(read / WEAK)))


def _antiphase_residual() -> float:
    """What two equal echoes in antiphase at one place leave of a single one."""
    radar = small_radar()
    place = [15.0, -3.0, 0.2]
    cube = cube_of_paths(points([place, place], amplitude=[1.0, -1.0]), radar)
    return float(np.abs(cube).max())


def _antiphase_by_geometry() -> float:
    """Error of the cube of two echoes a quarter wavelength apart, relative to one of them."""
    radar = small_radar()
    paths = points([[15.0, 0.0, 0.0], [15.0 + 0.25 * radar.waveform.wavelength_m, 0.0, 0.0]])
    return float(np.abs(cube_of_paths(paths, radar) - if_cube(paths, radar)).max())


def _crowd(spread_m: float) -> float:
    """Error of the cube of 100 000 echoes within ``spread_m`` of one point: of nearly one phase, or of any."""
    radar = _monostatic(small_radar(samples=32, chirps=1))
    generator = np.random.default_rng(1)
    place = np.array([12.0, 2.0, 0.0]) + generator.uniform(-spread_m, spread_m, (100_000, 3))
    return cube_error(points(place, amplitude=generator.uniform(0.5, 1.0, len(place))), radar)


def _equal_crowd() -> float:
    """The same for 100 000 equal echoes at one point: rounding errors of a running sum would all have one sign."""
    radar = _monostatic(small_radar(samples=32, chirps=1))
    return cube_error(points(np.tile([12.0, 2.0, 0.0], (100_000, 1)), amplitude=np.full(100_000, 0.1)), radar)


def _doppler_cell(velocity_in_steps: float, expected: int) -> float:
    """Cells between where a radial velocity is seen and where it folds to."""
    radar = _monostatic(small_radar())
    rate = velocity_in_steps * radar.waveform.velocity_step_mps
    paths = points([[15.0, 0.0, 0.0]], [[rate, 0.0, 0.0]])
    spectra = range_doppler(cube_of_paths(paths, radar).astype(np.complex64), radar)
    row = round(15.0 / radar.waveform.range_step_m)
    return abs(int(select_doppler(spectra, 0.0).cells[0, row]) - expected)


def _crossing_truth_db() -> float:
    """Largest error of the truth rows that a target crosses within the 10 ms, relative to its amplitude."""
    radar = small_radar(chirps=128, chirp_interval_s=80.6e-6)
    paths = points([[12.0, 1.0, 0.0]], [[45.0, 5.0, 0.0]])
    rows = (78, 80, 82, 84)
    spectra = range_doppler(cube_of_paths(paths, radar).astype(np.complex64), radar)
    cells = select_doppler(spectra, 0.0).cells[0]
    images = near_field_images(truth_moments(paths, radar, cells)[None], radar, radar.virtual_sensor)[0]
    return peak_error_db(images[list(rows)], truth_rows(paths, radar, cells, rows))


def _degenerate(radar: Radar) -> float:
    """Error of the cube of a few moving echoes; infinite if the frame made of them holds anything not finite."""
    # Within the unambiguous range of even the shortest sweep, or folded back onto it, as the sum of eq. (1) does.
    paths = points([[3.0, 0.5, 0.0], [9.0, -2.0, 0.1]], [[1.0, 0.0, 0.0], [0.0, -2.0, 0.0]], [1.0, 0.5j])
    return np.inf if not_finite(frame_of(paths, radar)) else cube_error(paths, radar)


def _short_chirp() -> Radar:
    """A time-bandwidth product of 500, where the residual video phase differs most within a range cell."""
    return small_radar(samples=1, bandwidth_hz=50e6, chirp_duration_s=10e-6, residual_video_phase=True)


def _one_channel() -> Radar:
    radar = _monostatic(small_radar())
    return radar.model_copy(update={"virtual_sensor": radar.array})


def _long_sweep() -> float:
    """Error of the cube with 2^15 samples, with echoes in the first and in the last range bins."""
    radar = _monostatic(small_radar(samples=2**15, chirps=1))
    farthest = radar.waveform.unambiguous_range_m
    return cube_error(points([[0.3, 0.0, 0.0], [0.5 * farthest, 3.0, 0.0], [farthest - 0.1, 0.0, 0.0]]), radar)


def _carriers() -> float:
    """Largest error of the cube over carriers from 24 to 300 GHz, and angle bins that delay-and-sum is off by."""
    worst = 0.0
    for carrier_hz in (24e9, 60e9, 77e9, 140e9, 300e9):
        radar = small_radar(carrier_hz=carrier_hz)
        half = SPEED_OF_LIGHT / (4.0 * radar.waveform.mid_sweep_hz)
        centred = AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2.0 * half * (np.arange(12, dtype=np.float64) - 5.5)))
        radar = Radar(waveform=radar.waveform, array=centred, front_end=radar.front_end, grid=radar.grid)
        range_m, u = 100 * radar.waveform.range_step_m, float(radar.grid.u[20])
        paths = points([[range_m * np.sqrt(1.0 - u**2), range_m * u, 0.0]])
        spectra = range_doppler(cube_of_paths(paths, radar).astype(np.complex64), radar)
        image = np.abs(delay_and_sum(spectra[100, radar.waveform.chirps // 2], radar))
        worst = max(worst, cube_error(paths, radar), abs(int(image.argmax()) - 20))
    return worst


def _near(position: Sequence[float]) -> float:
    """Error of the cube of a scatterer next to the array; infinite if its frame holds anything not finite."""
    paths, radar = points([position]), small_radar()
    return np.inf if not_finite(frame_of(paths, radar)) else cube_error(paths, radar)


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
    HardCase(
        "120 dB in one cell", "the weak echo drowns in rounding of the strong (tolerance 1e-9)", 1e-3, "of the weak",
        lambda: _weak_echo_error(0.02),
    ),
    HardCase(
        "120 dB in neighbouring cells", "as above, one bin apart", 1e-3, "of the weak", lambda: _weak_echo_error(0.15)
    ),
    HardCase(
        "120 dB, default tolerance", "float32 sums cover an echo 120 dB down, 60 bins away", 1.0, "dB",
        _weak_echo_level_db,
    ),
    HardCase("antiphase, same place", "a sum of zero leaves rounding noise", 1e-6, "of one echo", _antiphase_residual),
    HardCase(
        "antiphase by a quarter wavelength", "cancellation magnifies errors of phase", 2e-6, "of one echo",
        _antiphase_by_geometry,
    ),
    HardCase("100 000 paths in one cell", "float32 running sums lose digits", 1e-6, "relative", lambda: _crowd(1e-4)),
    HardCase("100 000 incoherent paths in one cell", "small errors that all have one sign", 1e-6, "relative",
             lambda: _crowd(0.02)),
    HardCase("100 000 equal paths", "rounding errors of one sign add up", 1e-6, "relative", _equal_crowd),
    HardCase("Doppler at the ambiguity", "+v_max and -v_max are one cell", 0.0, "cells", lambda: _doppler_cell(-8, 0)),
    HardCase("Doppler at +v_max", "the upper edge is not on the axis", 0.0, "cells", lambda: _doppler_cell(8, 0)),
    HardCase("Doppler beyond the ambiguity", "folds to the wrong cell", 0.0, "cells", lambda: _doppler_cell(13, 5)),
    HardCase("crossing three range bins, truth", "its echo smears over rows", -40.0, "dB", _crossing_truth_db),
    HardCase("one chirp", "a window of length 1 is 0", 1e-6, "relative", lambda: _degenerate(small_radar(chirps=1))),
    HardCase("one sample", "no range at all", 1e-6, "relative", lambda: _degenerate(small_radar(samples=1))),
    HardCase("one sample, residual video phase", "terms dropped that only the shift can spare", 1e-6, "relative",
             lambda: _degenerate(_short_chirp())),
    HardCase("one channel", "no aperture", 1e-6, "relative", lambda: _degenerate(_one_channel())),
    HardCase("one range bin", "row 0 alone", 1e-6, "relative", lambda: _degenerate(small_radar(range_bins=1))),
    HardCase("odd samples and chirps", "centres between samples", 1e-6, "relative",
             lambda: _degenerate(small_radar(samples=63, chirps=7))),
    HardCase("2^15 samples", "phases over 5 km of range", 1e-6, "relative", _long_sweep),
    HardCase("carriers 24 to 300 GHz", "constants of 77 GHz", 1e-6, "relative or bins", _carriers),
)  # fmt: skip
