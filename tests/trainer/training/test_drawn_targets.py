"""Drawn targets: the ranges, shares and distances that their module states, over many crops."""

import numpy as np
import pytest
from tiny_radar import RADAR as TINY_RADAR

from shared.radar import Radar
from trainer.estimators.array import line_array
from trainer.training import online_points as module
from trainer.training.online_points import EXTENT_CELLS, FLASH_DB, LEVEL_DB, MOST_POINTS, SCATTERERS, draw_targets

RADAR, ROWS = Radar(), 160
CELL = line_array(RADAR).resolution_cell


def draw(seed, rows=ROWS):
    return draw_targets(np.random.default_rng(seed), rows, RADAR)


@pytest.fixture(scope="module")
def drawn():
    return [draw(seed) for seed in range(300)]


def test_every_target_lies_within_its_ranges(drawn):
    waveform = RADAR.waveform
    last = waveform.range_bins
    for targets in drawn:
        lengths = {len(targets.u), len(targets.amplitude), len(targets.point)}
        assert lengths == {len(targets.row)}
        assert (np.abs(targets.u) <= 1.0).all()
        # A group lies within the crop and one row before it, its points about it.
        spread = 6.0 * module.RANGE_SPREAD_BINS
        assert ((targets.row >= -1.0 - spread) & (targets.row <= ROWS + spread)).all()
        assert targets.first_row * waveform.range_step_m >= module.NEAREST_M - 1e-9
        assert targets.first_row <= last + 1e-9
        assert (~targets.point).sum() == SCATTERERS * len(targets.extended)
    level_db = 20.0 * np.log10(np.concatenate([np.abs(t.amplitude[t.point]) for t in drawn]))
    assert LEVEL_DB[0] - module.SPAN_DB <= level_db.min() < LEVEL_DB[0]
    assert LEVEL_DB[1] < level_db.max() <= LEVEL_DB[1] + FLASH_DB


def test_shares_are_those_stated(drawn):
    """Points of one group without a spread in range share their row exactly; so groups can be told from outside."""
    extended = sum(len(targets.extended) for targets in drawn)
    groups, flashes = [], 0
    for targets in drawn:
        row, point = targets.row, targets.point
        for value in np.unique(row[point]):
            members = point & (row == value)
            if members.sum() > 1:  # its points share a row: none of them is spread
                groups.append((np.sort(targets.u[members]), 20.0 * np.log10(np.abs(targets.amplitude[members]))))
        flashes += int((20.0 * np.log10(np.abs(targets.amplitude[point])) > LEVEL_DB[1]).sum() > 0)
    assert len(groups) > 1000
    sizes = np.bincount([len(u) for u, _ in groups], minlength=MOST_POINTS + 1)[2:]
    np.testing.assert_allclose(sizes / sizes.sum(), 1.0 / (MOST_POINTS - 1), atol=0.05)
    near_equal = np.mean([np.ptp(level) <= module.NEAR_SPAN_DB for _, level in groups if len(level) == MOST_POINTS])
    assert near_equal == pytest.approx(module.NEAR_EQUAL, abs=0.1)
    # Points over the whole axis leave wider gaps than those of a cluster.
    clustered = np.mean([np.diff(u).max() <= module.GAP_CELLS[1] * CELL for u, _ in groups if len(u) == MOST_POINTS])
    assert clustered == pytest.approx(module.CLUSTERED, abs=0.1)
    total = extended + 2.0 * len(groups) * MOST_POINTS / (MOST_POINTS - 1)  # half of all groups are spread in range
    assert extended / total == pytest.approx(module.EXTENDED, abs=0.03)
    assert flashes > 0


def test_pairs_of_one_cluster_keep_their_distance(monkeypatch):
    monkeypatch.setattr(module, "CLUSTERED", 1.0)
    gaps = []
    for seed in range(400):
        _, u, amplitude, point = module._points(np.random.default_rng(seed), 3.0, CELL, 20.0)
        assert point.all()
        assert 20.0 * np.log10(np.abs(amplitude).max()) == pytest.approx(20.0)
        if len(u) == 2 and np.abs(u).max() < 1.0:
            gaps.append(np.ptp(u) / CELL)
    low, high = module.GAP_CELLS
    assert low * (1 - 1e-9) <= min(gaps)
    assert max(gaps) <= high * (1 + 1e-9)
    # A uniform logarithm: half of them below the geometric mean.
    assert np.mean(np.array(gaps) < np.sqrt(low * high)) == pytest.approx(0.5, abs=0.2)


def test_an_extended_target_holds_the_cells_over_its_width(drawn):
    widths = np.concatenate([2.0 * targets.extended[:, 2] for targets in drawn]) / CELL
    assert EXTENT_CELLS[0] <= widths.min() < 0.5
    assert 3.0 < widths.max() <= EXTENT_CELLS[1]
    power = [np.sum(np.abs(module._surface(np.random.default_rng(n), 0.0, 0.0, 0.1, 20.0)[2]) ** 2) for n in range(500)]
    assert np.mean(power) == pytest.approx(100.0, rel=0.05)
    targets = next(found for found in drawn if len(found.extended))
    rows, u = np.rint(targets.extended[:, 0]).astype(int), targets.extended[:, 1]
    assert targets.in_extended(rows, u).all()
    none = np.empty(0)
    alone = module.Targets(
        none, none, none.astype(complex), none.astype(bool), 0.0, extended=np.array([[7.2, 0.1, 0.05]])
    )
    found = alone.in_extended(np.array([6, 7, 8, 9, 7, 7]), np.array([0.1, 0.14, 0.06, 0.1, 0.16, 0.04]))
    assert found.tolist() == [True, True, True, False, False, False]


def test_a_draw_is_a_function_of_its_generator():
    one, same, other = draw(5), draw(5), draw(6)
    for name in ("row", "u", "amplitude", "point", "first_row", "extended"):
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    assert one.row.shape != other.row.shape or (one.row != other.row).any()


def test_a_radar_that_sees_less_than_the_nearest_range_gets_targets_all_the_same(monkeypatch):
    monkeypatch.setattr(module, "NEAREST_M", 1e3)
    targets = draw_targets(np.random.default_rng(0), 2000, TINY_RADAR)
    assert len(targets.row)
    assert targets.first_row == pytest.approx(TINY_RADAR.waveform.range_bins)
