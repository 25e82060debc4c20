"""The truth of torch's kernels: near the compiled one, and from the virtual sensor's own cube as far as that one."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import relative_error
from path_tables import a_table, truth_radar
from torch_devices import EVERY_DEVICE, required

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import torch_kernels
from datafactory.synthesis.truth import truth_moments
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import DEFAULT_TERMS

TERMS_LEFT_OUT = 2e-3
"""Of compiled paths with fewer Doppler terms than the cell's most demanding one has: below DOPPLER_ERROR, 3e-3."""

pytestmark = pytest.mark.parametrize("device", EVERY_DEVICE)


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
