"""Fewer paths of the same power."""

from __future__ import annotations

import numpy as np

from datafactory.paths.solver import TraceSettings
from datafactory.paths.thinning import cell_of, thinned


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def drawn_cells(paths: int = 20_000, cells: int = 900):
    """Cells of 0 to 60 paths and of powers over 16 decades."""
    random = rng(7)
    cell = random.integers(cells, size=paths) * 17 - 31
    return cell, random.exponential(size=paths) * 10.0 ** ((cell % 17) - 8)


def test_every_cell_keeps_its_power_and_no_more_than_so_many_paths():
    cell, power = drawn_cells()
    for most in (1, 2, 5, 8):
        index, factor = thinned(cell, power, most, rng())
        _, place = np.unique(cell, return_inverse=True)
        before = np.bincount(place, power)
        after = np.bincount(place[index], power[index] * factor, len(before))
        np.testing.assert_allclose(after, before, rtol=1e-9)
        np.testing.assert_array_equal(
            np.bincount(place[index], minlength=len(before)), np.minimum(np.bincount(place), most)
        )
        assert (np.diff(index) > 0).all()


def test_any_part_of_a_cell_has_its_power_on_average():
    power = np.array([30.0, 9.0, 4.0, 3.0, 2.0, 1.0, 1.0, 0.5, 1e-3])
    cell = np.zeros(len(power), dtype=np.int64)
    sums, trials = np.zeros(len(power)), 40_000
    random = rng(3)
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
        index, factor = thinned(cell, power, most, rng())
        np.testing.assert_array_equal(index, [0, 1, 3, 4])
        np.testing.assert_array_equal(factor, 1.0)
    index, factor = thinned(np.zeros(0, dtype=np.int64), np.zeros(0), 4, rng())
    assert len(index) == len(factor) == 0


def test_same_generator_same_choice():
    cell, power = drawn_cells(3_000)
    first, again, other = (thinned(cell, power, 2, rng(seed))[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_cells_that_lie_across_those_that_are_thinned_scatter_by_the_root_of_what_is_kept():
    """Why more rays ask for more paths a cell: 400 even paths a cell, looked at in cells shifted by half of one."""
    cells, dense = 400, 400
    random = rng(2)
    place = random.random(cells * dense) * cells
    scatter = []
    for most in (6, 24, 96):
        index, factor = thinned(place.astype(np.int64), np.ones(len(place)), most, random)
        power = np.bincount((place[index] + 0.5).astype(np.int64), factor, cells + 1)[1:-1] / dense
        scatter.append(float(np.std(power)) * np.sqrt(most))
    # Two halves, each of a draw of its own: a share of 1/2 of K / 2 paths twice, so 1 / sqrt(2 K) if these are drawn
    # one by one, less where they are drawn by turns.
    assert all(0.3 < value < 1.0 for value in scatter)
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
    cell, power = drawn_cells(4000, 150)
    power[::11] = 0.0
    for most in (1, 3, 6):
        index, factor = thinned(cell, power, most, rng(5))
        expected, of_expected = by_numpy(cell, power, most, rng(5))
        np.testing.assert_array_equal(index, expected)
        np.testing.assert_allclose(factor, of_expected, rtol=1e-12)
