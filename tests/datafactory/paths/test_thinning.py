"""Fewer paths of the same power: thinned, pruned, sorted, counted; against sums written out."""

import numpy as np
import pytest

from datafactory.paths.cells import cell_of, lit_cells, pruned, rising, thinned
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFUSE, TARGET, PathTable, ScatteredPaths
from shared.radar import Radar


def test_any_part_of_a_cell_has_its_power_on_average():
    power = np.array([30.0, 9.0, 4.0, 3.0, 2.0, 1.0, 1.0, 0.5, 1e-3])
    cell = np.zeros(len(power), dtype=np.int64)
    sums, trials = np.zeros(len(power)), 40_000
    random = np.random.default_rng(3)
    for _ in range(trials):
        index, factor = thinned(cell, power, 4, random)
        sums[index] += power[index] * factor
    # 30 holds more than a quarter, 9 more than a third of the rest, and 4 half of what is left: they stay.
    np.testing.assert_allclose(sums[0] / trials, power[0])
    probable = np.minimum(power[2:] * 2.0 / power[2:].sum(), 1.0)
    deviation = power[2:] * np.sqrt((1.0 / probable - 1.0) / trials)
    assert (np.abs(sums[2:] / trials - power[2:]) < 5.0 * deviation + 1e-12).all()


def test_few_paths_and_no_limit_change_nothing_and_the_dark_are_left_out():
    cell, power = np.array([5, 5, 2, 2, 5]), np.array([1.0, 2.0, 0.0, 4.0, 3.0])
    for most in (0, 3):
        index, factor = thinned(cell, power, most, np.random.default_rng(0))
        np.testing.assert_array_equal(index, [0, 1, 3, 4])
        np.testing.assert_array_equal(factor, 1.0)
    index, factor = thinned(np.zeros(0, dtype=np.int64), np.zeros(0), 4, np.random.default_rng(0))
    assert len(index) == len(factor) == 0


def test_more_rays_than_usual_keep_as_many_times_more_paths_in_a_cell():
    """Else cells shifted by half of one would scatter as before, however many rays there are."""
    assert TraceSettings().most_in_a_cell == TraceSettings(rays=1_000).most_in_a_cell == 6
    assert TraceSettings(rays=4 * TraceSettings().rays).most_in_a_cell == 24
    assert TraceSettings(rays=4 * TraceSettings().rays, paths_a_cell=0).most_in_a_cell == 0


def test_cells_are_told_apart_by_range_side_and_rate():
    def one(range_m: float, u: float, rate: float) -> int:
        return int(cell_of(range_m, u, rate))

    here = one(10.01, 0.301, 0.0)
    assert one(10.02, 0.302, 0.01) == here
    numbers = {here, one(10.2, 0.301, 0.0), one(10.01, 0.32, 0.0), one(10.01, 0.301, 0.3), one(10.01, 0.301, -0.3)}
    assert len(numbers) == 5
    assert one(99_999.0, 1.0, 9_999.0) != one(99_999.0, 1.0, -9_999.0)


def by_numpy(cell, power, most, random):
    """The same by whole arrays: cells in rising order, a draw each, shares of what its large paths leave."""
    lit = np.flatnonzero(power > 0.0)
    kept, factors = [], []
    numbers = np.unique(cell[lit])
    for number, shift in zip(numbers, random.random(len(numbers)), strict=True):
        members = lit[cell[lit] == number]
        own, large = power[members], np.full(len(members), len(members) <= most)
        while (more := ~large & (own * (most - large.sum()) >= own[~large].sum())).any():
            large |= more
        wanted = most - large.sum()
        share = np.where(large, 0.0, own) / max(own[~large].sum(), np.finfo(float).tiny)
        until = wanted * np.cumsum(share)
        until[-1] = wanted
        drawn = ~large & (np.floor(until + shift) > np.floor(np.append(0.0, until[:-1]) + shift))
        kept += members[large | drawn].tolist()
        factors += np.where(large, 1.0, 1.0 / np.where(drawn, wanted * share, 1.0))[large | drawn].tolist()
    order = np.argsort(kept)
    return np.array(kept)[order], np.array(factors)[order]


def test_the_same_paths_are_kept_as_by_whole_arrays():
    # Cells of a few paths to dozens, and powers over 16 decades.
    random = np.random.default_rng(7)
    cell = random.integers(150, size=4000) * 17 - 31
    power = random.exponential(size=4000) * 10.0 ** ((cell % 17) - 8)
    power[::11] = 0.0
    for most in (1, 3, 6):
        index, factor = thinned(cell, power, most, np.random.default_rng(5))
        expected, of_expected = by_numpy(cell, power, most, np.random.default_rng(5))
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_allclose(factor, of_expected, rtol=1e-12)


@pytest.mark.parametrize("span", [1, 50, 8_191, 8_192, 8_193, 2**63 - 1])
@pytest.mark.parametrize("count", [0, 2, 20_000])
def test_numbers_are_ordered_as_by_a_stable_sort(count, span):
    random = np.random.default_rng(span)
    numbers = random.integers(-(span // 2), span - span // 2, size=count)
    np.testing.assert_array_equal(rising(numbers), np.argsort(numbers, kind="stable"))


def at(range_m: np.ndarray, u: np.ndarray, amplitude: np.ndarray, away_mps: float = 0.0, kinds=DIFFUSE) -> PathTable:
    """Points, the last of which moves away at ``away_mps``."""
    position = np.stack([range_m * np.sqrt(1 - u**2), range_m * u, np.zeros_like(u)], axis=1)
    velocity = np.zeros_like(position)
    velocity[-1] = away_mps * position[-1] / range_m[-1]
    return PathTable(ScatteredPaths.of_points(position, velocity, amplitude.astype(complex), kinds=kinds))


def test_cells_with_few_paths_are_counted():
    """Seven paths in one cell, three in the next range bin, one outside the image."""
    step = Radar().waveform.range_step_m
    range_m = step * np.array([100.5] * 7 + [101.5] * 3 + [100.5])
    u = np.array([0.1] * 10 + [0.9])
    counts = lit_cells(at(range_m, u, np.ones(11)), Radar())
    assert counts == {"cells_lit": 2, "cells_lit_by_fewer_than_5_paths": 1}


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


def test_pruning_leaves_what_has_a_doppler_cell_of_its_own_and_point_targets():
    """50 dB below a wall at its range: one point of a moving body, and a target that stands."""
    range_m, amplitude = np.full(3, 10.02), np.sqrt([1.0, 1e-5, 1e-5])
    moving = pruned(at(range_m, np.zeros(3), amplitude, away_mps=5.0), Radar(), -40.0)
    assert moving.scattered.tx_velocity[:, 0].tolist() == [0.0, 5.0]
    assert moving.counts["pruned"] == 1
    kinds = np.array([DIFFUSE, DIFFUSE, TARGET], dtype=np.uint8)
    standing = pruned(at(range_m, np.zeros(3), amplitude, kinds=kinds), Radar(), -40.0)
    assert standing.scattered.kinds.tolist() == [DIFFUSE, TARGET]
