"""Counting sparse cells and pruning weak paths, against sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from datafactory.paths.density import lit_cells
from datafactory.paths.prune import _by_group_and_power, pruned
from datafactory.paths.table import PathTable, ScatteredPaths
from shared.radar import Radar


def at(range_m: np.ndarray, u: np.ndarray, amplitude: np.ndarray) -> PathTable:
    position = np.stack([range_m * np.sqrt(1 - u**2), range_m * u, np.zeros_like(u)], axis=1)
    return PathTable(ScatteredPaths.of_points(position, np.zeros_like(position), amplitude.astype(complex)))


def test_cells_with_few_paths_are_counted():
    """Seven paths in one cell, three in the next range bin, one outside the image."""
    step = Radar().waveform.range_step_m
    range_m = step * np.array([100.5] * 7 + [101.5] * 3 + [100.5])
    u = np.array([0.1] * 10 + [0.9])
    counts = lit_cells(at(range_m, u, np.ones(11)), Radar())
    assert counts == {"cells_lit": 2, "cells_lit_by_fewer_than_5_paths": 1}


def test_an_empty_table_lights_nothing():
    empty = np.zeros(0)
    assert lit_cells(at(empty, empty, empty), Radar()) == {"cells_lit": 0, "cells_lit_by_fewer_than_5_paths": 0}


@pytest.mark.parametrize("level_db", [-60.0, -40.0, -20.0])
def test_pruning_keeps_every_range_bin_within_its_level(level_db):
    generator = np.random.default_rng(3)
    range_m = generator.uniform(1.0, 40.0, 4000)
    amplitude = 10.0 ** generator.uniform(-8.0, 0.0, 4000) / range_m**2
    table = at(range_m, generator.uniform(-0.8, 0.8, 4000), amplitude)
    kept = pruned(table, Radar(), level_db)
    assert kept.counts["pruned"] == 4000 - len(kept) > 0
    row = np.floor(table.scattered.range_m() / Radar().waveform.range_step_m).astype(int)
    row_kept = np.floor(kept.scattered.range_m() / Radar().waveform.range_step_m).astype(int)
    before = np.bincount(row, np.abs(table.scattered.amplitude) ** 2)
    after = np.bincount(row_kept, np.abs(kept.scattered.amplitude) ** 2, minlength=len(before))
    occupied = before > 0
    assert np.all(after[occupied] >= (1.0 - 1.0001 * 10.0 ** (level_db / 10.0)) * before[occupied])


def test_pruning_drops_as_many_as_the_level_allows():
    """Powers 1, 1e-3, 1e-5 in one bin: -40 dB allows the third alone, -20 dB the second and third."""
    range_m = np.full(3, 10.02)
    table = at(range_m, np.zeros(3), np.sqrt([1.0, 1e-3, 1e-5]))
    assert len(pruned(table, Radar(), -40.0)) == 2
    assert len(pruned(table, Radar(), -20.0)) == 1
    assert len(pruned(table, Radar(), -60.0)) == 3


def test_groups_are_sorted_as_by_lexsort():
    """Equal powers, none at all, and such as differ in their last bit."""
    random = np.random.default_rng(9)
    for count in (0, 1, 7, 5000):
        group, power = random.integers(0, 60, count), np.exp(6.0 * random.normal(size=count) - 40.0)
        power[::5], power[1::7] = 0.0, 1e-18
        power[2::7] = np.nextafter(1e-18, 1.0)
        np.testing.assert_array_equal(_by_group_and_power(group, power), np.lexsort((power, group)))
