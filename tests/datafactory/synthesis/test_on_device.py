"""torch's kernels: the cube against the float64 sum with the compiled kernels' bounds, the truth near theirs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import if_cube, relative_error
from path_tables import a_table, radar_of, truth_radar

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths, torch_kernels
from datafactory.synthesis.device import arrays
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, sorted_paths
from datafactory.synthesis.truth import truth_moments
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import DEFAULT_TERMS

EVERY_DEVICE = ("cpu", pytest.param("cuda", marks=pytest.mark.gpu))
"""For ``pytest.mark.parametrize("device", ...)``, with :func:`required` at the start of the test."""


def required(device: str) -> str:
    """The device, or a skip that says why it is not there."""
    if device == "cuda":
        from datafactory.synthesis.cube import synthesis_problem

        if (problem := synthesis_problem()) is not None:
            pytest.skip(f"no CUDA device: {problem}")
    return device


SPACE = AntennaArray(
    tx_m=((0.0, -0.04, 0.01), (0.0, 0.03, -0.02)), rx_m=((0.01, 0.0, 0.0), (0.0, 0.03, -0.02), (0.0, 0.0, 0.04))
)

pytestmark = pytest.mark.parametrize("device", EVERY_DEVICE)


def slowed(table: PathTable, factor: float) -> PathTable:
    """A table's paths at this share of their speeds."""
    scattered, specular = table.scattered, table.specular
    return PathTable(
        replace(
            scattered,
            tx_velocity=factor * scattered.tx_velocity,
            rx_velocity=factor * scattered.rx_velocity,
            between_rate_mps=factor * scattered.between_rate_mps,
        ),
        replace(specular, image_velocity=factor * specular.image_velocity),
    )


def cube_on(
    device: str, table: PathTable, radar: Radar, tolerance: float, intra_chirp: bool = False
) -> NDArray[np.complexfloating]:
    recording = Recording(radar, tolerance, intra_chirp)
    return torch_kernels(required(device)).cube(sorted_paths(table, recording), recording, 1)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-9])
@pytest.mark.parametrize(
    ("nearest_m", "farthest_m", "speed", "waveform"),
    [
        (0.6, 30.0, 0.0, {}),
        (0.6, 6.0, 0.1, {}),
        (3.0, 40.0, 1.0, {}),
        (20.0, 150.0, 4.0, {}),
        (3.0, 40.0, 1.0, {"multiplexing": "tdm"}),
        (3.0, 40.0, 1.0, {"residual_video_phase": True}),
    ],
)
def test_cube_keeps_its_tolerance(device, tolerance, nearest_m, farthest_m, speed, waveform):
    # Standing, slow and near, moving, fast and far; 64 samples reach to 9.6 m, so that most echoes are folded.
    radar = radar_of(**waveform)
    table = slowed(a_table(np.random.default_rng(31), 10, nearest_m, farthest_m), speed)
    made = cube_on(device, table, radar, tolerance)
    assert made.dtype == (np.complex64 if tolerance >= FLOAT32_TOLERANCE else np.complex128)
    assert relative_error(made, if_cube(table, radar)) <= tolerance


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_motion_within_the_chirp_is_that_of_the_exact_kernel(device, tolerance):
    # Which test_cube.py holds to the sum over all samples, at 1e-9.
    radar, table = radar_of(array=SPACE), slowed(a_table(np.random.default_rng(32), 12, 3.0), 0.8)
    exact = cube_of_paths(table, radar, 1e-9, intra_chirp=True)
    assert relative_error(cube_on(device, table, radar, tolerance, intra_chirp=True), exact) <= tolerance


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_a_wide_array_in_blocks_of_rx(device, tolerance):
    sensor = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=line(np.linspace(-0.25, 0.25, 24)))
    radar, table = radar_of(array=sensor), a_table(np.random.default_rng(34), 6, 2.0)
    assert relative_error(cube_on(device, table, radar, tolerance), if_cube(table, radar)) <= tolerance


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_crowd_in_one_cell_keeps_the_tolerance(device, speed):
    # 2000 equal paths in one range cell: float32 alone would lose 1e-5, see CROWD.
    generator = np.random.default_rng(35)
    place = np.array([5.0, 1.0, 0.0]) + generator.uniform(-0.002, 0.002, (2000, 3))
    paths = PathTable(ScatteredPaths.of_points(place, np.tile([speed, 0.0, 0.0], (2000, 1)), np.ones(2000)))
    radar = radar_of(samples=32, chirps=16)
    assert relative_error(cube_on(device, paths, radar, 1e-6), if_cube(paths, radar)) <= 1e-6


def test_small_batches_are_the_same_sum(device, monkeypatch):
    radar, table = radar_of(), a_table(np.random.default_rng(36), 30, 2.0)
    at_once = cube_on(device, table, radar, 1e-4)
    monkeypatch.setitem(arrays.VALUES_AT_ONCE, device, 2**9)
    assert relative_error(cube_on(device, table, radar, 1e-4), at_once) < 1e-5


@pytest.mark.parametrize("tolerance", [1e-3, 1e-9])
def test_the_same_bytes_from_run_to_run_and_a_silent_cube_of_an_empty_table(device, tolerance):
    radar, table = radar_of(), a_table(np.random.default_rng(37), 200, 2.0)
    first, second = (cube_on(device, table, radar, tolerance) for _ in range(2))
    assert first.tobytes() == second.tobytes()
    silent = cube_on(device, PathTable(ScatteredPaths.none()), radar, tolerance)
    assert silent.shape == first.shape
    assert not silent.any()


TERMS_LEFT_OUT = 2e-3
"""Of compiled paths with fewer Doppler terms than the cell's most demanding one has: below DOPPLER_ERROR, 3e-3."""


def some_cells(radar: Radar, seed: int) -> np.ndarray:
    """[R] any Doppler cells."""
    return np.random.default_rng(seed).integers(0, radar.waveform.chirps, radar.waveform.range_bins)


def truth_on(device: str, table: PathTable, radar: Radar, cells: np.ndarray, intra_chirp: bool = False):
    return torch_kernels(required(device)).truth(table, radar, cells, DEFAULT_TERMS, intra_chirp)


@pytest.mark.parametrize(("seed", "intra_chirp"), [(42, False), (43, False), (45, True)])
def test_moments_are_those_of_the_compiled_kernel(device, seed, intra_chirp):
    # Paths of every kind, each row in any Doppler cell.
    radar = truth_radar(64, 60)
    table, cells = a_table(np.random.default_rng(seed), 30, 1.0), some_cells(radar, seed)
    compiled = truth_moments(table, radar, cells, intra_chirp=intra_chirp)
    made = truth_on(device, table, radar, cells, intra_chirp)
    assert made.dtype == compiled.dtype == np.complex64
    assert relative_error(made, compiled) < TERMS_LEFT_OUT


def test_standing_paths_have_one_term_and_agree_to_rounding(device):
    radar = truth_radar(64, 60, 4)
    table = a_table(np.random.default_rng(44), 30, 1.0).at_rest(0.0)
    cells = np.full(60, 2)
    assert relative_error(truth_on(device, table, radar, cells), truth_moments(table, radar, cells)) < 1e-6


def test_a_sensor_that_does_not_fill_its_last_block(device):
    sensor = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=line(np.linspace(-0.1, 0.1, 41)))
    radar = truth_radar(64, 60).model_copy(update={"virtual_sensor": sensor})
    table, cells = a_table(np.random.default_rng(46), 20, 1.0), some_cells(radar, 46)
    made = truth_on(device, table, radar, cells)
    assert made.shape == (DEFAULT_TERMS, 60, 41)
    assert relative_error(made, truth_moments(table, radar, cells)) < TERMS_LEFT_OUT


def test_the_same_bytes_from_run_to_run(device):
    radar = truth_radar(64, 60)
    table, cells = a_table(np.random.default_rng(47), 60, 1.0), some_cells(radar, 47)
    assert truth_on(device, table, radar, cells).tobytes() == truth_on(device, table, radar, cells).tobytes()
    assert not truth_on(device, PathTable(ScatteredPaths.none()), radar, cells).any()
