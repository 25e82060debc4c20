"""Random radars, arrays and echoes: what holds of the IF signal whatever they are.

Scaling by a power of two changes no digit and is asked to change no bit; everything else holds to the cube's tolerance,
relative to the largest the cube could be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles import if_cube
from path_tables import random_table

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

TOLERANCE = 1e-6
EXAMPLES = 20

coordinate = st.floats(-0.0625, 0.0625, width=32)
elements = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=3).map(tuple)
arrays = st.builds(lambda tx, rx: AntennaArray(tx_m=tx, rx_m=rx), elements, elements)


@st.composite
def radars(draw: st.DrawFn) -> Radar:
    """Any carrier, bandwidth, frame shape and multiplexing."""
    array = draw(arrays)
    samples, chirps = draw(st.integers(1, 48)), draw(st.integers(1, 6))
    duration = draw(st.floats(10e-6, 100e-6))
    waveform = Waveform(
        carrier_hz=draw(st.floats(24e9, 300e9)),
        bandwidth_hz=draw(st.floats(50e6, 4e9)),
        chirp_duration_s=duration,
        chirp_interval_s=duration * draw(st.floats(1.0, 2.0)) * len(array.tx_m),
        chirps=chirps,
        samples=samples,
        range_bins=samples,
        multiplexing=draw(st.sampled_from(["simultaneous", "tdm"])),
        residual_video_phase=draw(st.booleans()),
    )
    return Radar(waveform=waveform, array=array)


@st.composite
def echoes(draw: st.DrawFn, most: int = 12) -> ScatteredPaths:
    """Paths of one and of several bounces, moving, over five decades of amplitude."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return random_table(generator, draw(st.integers(1, most)), 0, (0.5, 60.0), 100.0, 40.0).scattered


def cube_of(paths: ScatteredPaths, radar: Radar) -> NDArray:
    return cube_of_paths(PathTable(paths), radar, TOLERANCE)


def same(one: NDArray, other: NDArray, paths: ScatteredPaths) -> bool:
    """Whether two cubes agree to the tolerance, of what the paths would be without cancellation."""
    scale = np.linalg.norm(paths.amplitude) * np.sqrt(one.size)
    return bool(np.isfinite(one).all() and np.linalg.norm(one - other) <= TOLERANCE * scale)


@settings(max_examples=EXAMPLES)
@given(radars(), echoes(), st.integers(-60, 60))
def test_the_same_input_makes_the_same_bytes_and_scaling_changes_no_digit(
    radar: Radar, paths: ScatteredPaths, power: int
) -> None:
    once = cube_of(paths, radar)
    assert cube_of(paths, radar).tobytes() == once.tobytes()
    threads = cube_of_paths(PathTable(paths), radar, TOLERANCE, threads=2)
    assert threads.tobytes() == once.tobytes()
    scale = np.float32(2.0**power)
    scaled = cube_of(replace(paths, amplitude=paths.amplitude * float(scale)), radar)
    np.testing.assert_array_equal(scaled, once * scale)


@settings(max_examples=4 * EXAMPLES)
@given(radars(), echoes())
def test_the_cube_is_the_sum_over_its_paths(radar: Radar, paths: ScatteredPaths) -> None:
    """Whatever holds of that sum holds of the cube to twice the tolerance: reversed and mirrored paths, a later start,
    parts, another order, a common phase."""
    assert same(cube_of(paths, radar), if_cube(PathTable(paths), radar), paths)
