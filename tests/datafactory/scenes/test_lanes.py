"""Lanes: along the middle of streets and to the right of it, on allowed cells alone, smooth."""

from __future__ import annotations

import numpy as np
import pytest
from town_scenes import BUILDINGS, PLATE, box, flat, sheet

from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.lanes import LANE_OFFSET_M, STEP_M, Lane, draw_lane
from datafactory.scenes.scene import Scene


@pytest.fixture(scope="module")
def street() -> Ground:
    return free_ground(Scene("town", (PLATE, *BUILDINGS)))


@pytest.fixture(scope="module")
def crossing() -> Ground:
    """Two streets 20 m wide that cross between four blocks."""
    blocks = [
        box(f"block{x}{y}", (x, y, 0.0), (x + 60.0, y + 60.0, 9.0)) for x in (-70.0, 10.0) for y in (-70.0, 10.0)
    ]  # fmt: skip
    return free_ground(Scene("crossing", (sheet("floor", (-75.0, 75.0), (-75.0, 75.0), flat), *blocks)))


def drawn(ground: Ground, length_m: float, seed: int) -> Lane:
    lane = draw_lane(ground, length_m, np.random.default_rng(seed), ground.street)
    assert lane is not None
    return lane


def test_a_lane_keeps_to_the_right_of_the_street_s_middle(street: Ground) -> None:
    """The street lies along y = 0. Whoever drives to positive x keeps at negative y, and the other way round."""
    both = set()
    for seed in range(12):
        lane = drawn(street, 40.0, seed)
        straight = np.abs(np.sin(lane.heading_rad)) < 0.02
        to_x = np.sign(np.cos(lane.heading_rad[straight]))
        np.testing.assert_allclose(lane.points[straight, 1], -to_x * LANE_OFFSET_M, atol=0.6)
        both |= set(to_x)
    assert both == {-1.0, 1.0}


def test_every_point_is_on_an_allowed_cell(crossing: Ground) -> None:
    for seed in range(12):
        i, j = crossing.cell_of(*drawn(crossing, 60.0, seed).points.T)
        assert crossing.street[i, j].all()


def test_lanes_turn_at_crossings_as_a_car_can(crossing: Ground) -> None:
    """A radius of at least 5 m, and some lane of twelve goes round the corner."""
    turned = []
    for seed in range(12):
        lane = drawn(crossing, 60.0, seed)
        assert np.abs(lane.curvature).max() < 1.0 / 5.0
        turned.append(np.ptp(lane.heading_rad))
    assert max(turned) > 1.3


def test_points_stand_evenly_and_the_length_is_what_was_wanted(crossing: Ground) -> None:
    for seed in range(6):
        lane = drawn(crossing, 50.0, seed)
        steps = np.hypot(*np.diff(lane.points, axis=0).T)
        assert np.all((steps > 0.8 * STEP_M) & (steps <= STEP_M + 1e-9))
        assert 49.0 < lane.length_m < 52.0


def test_a_circle_has_the_curvature_of_a_circle() -> None:
    angle = np.linspace(0.0, np.pi, 200)
    lane = Lane(20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert lane.length_m == pytest.approx(20.0 * np.pi, rel=1e-3)
    np.testing.assert_allclose(lane.curvature[3:-3], 1.0 / 20.0, rtol=1e-3)
    np.testing.assert_allclose(np.diff(lane.heading_rad[2:-2]), np.pi / 199, rtol=1e-3)


def test_the_same_generator_draws_the_same_lane(crossing: Ground) -> None:
    np.testing.assert_array_equal(drawn(crossing, 60.0, 5).points, drawn(crossing, 60.0, 5).points)
    assert not np.array_equal(drawn(crossing, 60.0, 5).points, drawn(crossing, 60.0, 6).points)


def test_cells_without_room_have_no_lane(crossing: Ground) -> None:
    assert draw_lane(crossing, 50.0, np.random.default_rng(0), np.zeros_like(crossing.free)) is None
    spots = np.zeros_like(crossing.free)
    spots[150:152, 150:152] = True
    assert draw_lane(crossing, 50.0, np.random.default_rng(0), spots) is None
