"""Lanes and who drives on them: to the right, one behind the other, at red lights not at all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from datafactory.scenes.city.city import city
from datafactory.scenes.city.lanes import Way, lanes_of
from datafactory.scenes.city.options import CityOptions
from datafactory.scenes.city.placement import Keyframe
from datafactory.scenes.city.plan import Plan, draw_plan
from datafactory.scenes.city.rules import RULES
from datafactory.scenes.city.style import Style
from datafactory.scenes.city.traffic import (
    CLEARING_S,
    DURATION_S,
    GREEN_S,
    STANDING_GAP_M,
    TURNING_MPS,
    Vehicle,
    drive,
    phase_at,
    thinned,
)


def plan(seed: int = 0) -> Plan:
    return draw_plan(np.random.default_rng(seed), RULES[Style.OLD_TOWN], 2)


def speeds(vehicle: Vehicle) -> np.ndarray:
    places = np.array([key.position[:2] for key in vehicle.keys])
    times = np.array([key.time_s for key in vehicle.keys])
    return np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)


def test_lanes_keep_right_and_stop_before_their_crossings() -> None:
    drawn = plan()
    for way in lanes_of(drawn, turns=False):
        (x0, y0), (x1, y1) = way.points[0], way.points[-1]
        street = min(drawn.streets, key=lambda item: abs((y0 if abs(x1 - x0) > 1.0 else x0) - item.at))
        heading = np.array([x1 - x0, y1 - y0]) / way.length
        centre = np.array([x0, street.at] if street.axis == "x" else [street.at, y0])
        right = np.array([heading[1], -heading[0]])
        assert (np.array([x0, y0]) - centre) @ right > 0.5 * street.kind.lane_m - 1e-9
        for stop, _ in way.stops:
            x, y, _ = way.at(stop)
            assert not any(
                other.strip(other.kind.facade).holds(x, y) for other in drawn.streets if other.axis != street.axis
            )


def test_a_turn_leads_from_one_lane_into_the_other() -> None:
    ways = lanes_of(plan(), turns=True)
    turns = [(way, *item) for way in ways for item in way.onto]
    assert turns
    for way, leaves, turn, _ in turns:
        assert way.at(leaves)[:2] == pytest.approx(turn.at(0.0)[:2], abs=1e-6)
        _, target, joins = turn.onto[0]
        assert turn.at(turn.length)[:2] == pytest.approx(target.at(joins)[:2], abs=1e-6)
        entered, left = way.at(leaves)[2], target.at(joins)[2]
        assert (left - entered + 90.0) % 360.0 == pytest.approx(0.0, abs=1e-6)  # to the right


def test_a_lone_vehicle_keeps_the_speed_it_wants() -> None:
    vehicle = Vehicle("Saloon", 4.6, 11.0, Way(np.array([(0.0, 0.0), (500.0, 0.0)])), 10.0)
    drive([vehicle])
    assert speeds(vehicle) == pytest.approx(11.0, abs=0.01)
    assert vehicle.keys[-1].position[0] == pytest.approx(10.0 + 11.0 * DURATION_S, abs=0.2)


def test_who_follows_a_slower_one_ends_at_its_speed_behind_it() -> None:
    way = Way(np.array([(0.0, 0.0), (900.0, 0.0)]))
    slow, fast = Vehicle("Bus", 11.5, 5.0, way, 120.0), Vehicle("Saloon", 4.6, 13.0, way, 60.0)
    drive([fast, slow], duration_s=60.0)
    assert speeds(fast)[-1] == pytest.approx(5.0, abs=0.3)
    gap = slow.keys[-1].position[0] - fast.keys[-1].position[0] - 0.5 * (11.5 + 4.6)
    # Equilibrium of the model: (s0 + v T) / sqrt(1 - (v / v0)^4).
    assert gap == pytest.approx((STANDING_GAP_M + 5.0 * 1.3) / math.sqrt(1.0 - (5.0 / 13.0) ** 4), rel=0.15)


def test_vehicles_wait_at_red_and_go_at_green() -> None:
    way = Way(np.array([(0.0, 0.0), (400.0, 0.0)]), stops=[(80.0, 1)])
    vehicle = Vehicle("Saloon", 4.6, 10.0, way, 20.0)
    drive([vehicle])
    places = {key.time_s: key.position[0] for key in vehicle.keys}
    before = [x for time_s, x in places.items() if time_s <= GREEN_S + CLEARING_S]
    assert max(before) < 80.0 - 0.5 * 4.6 + 0.3
    assert vehicle.keys[-1].position[0] > 90.0
    assert phase_at(0.0) == 0
    assert phase_at(GREEN_S + 1.0) is None
    assert phase_at(GREEN_S + CLEARING_S) == 1


def test_who_turns_slows_down_and_faces_where_it_goes() -> None:
    turning = [
        item
        for seed in range(6)
        for item in city(CityOptions(seed=seed))
        if item.path.startswith("Cars/") and item.keyframes
    ]
    turning = [item for item in turning if abs(item.keyframes[-1].yaw_deg - item.keyframes[0].yaw_deg) > 80.0]
    assert turning
    for item in turning:
        for one, two in zip(item.keyframes[:-1], item.keyframes[1:], strict=True):
            step = np.subtract(two.position[:2], one.position[:2])
            if abs(two.yaw_deg - one.yaw_deg) > 5.0:
                assert np.linalg.norm(step) / (two.time_s - one.time_s) < TURNING_MPS + 1.5
            if np.linalg.norm(step) > 0.5:
                middle = math.radians(0.5 * (one.yaw_deg + two.yaw_deg))
                assert step @ (math.cos(middle), math.sin(middle)) > 0.97 * np.linalg.norm(step)


def test_thinned_keyframes_are_the_same_motion() -> None:
    every = [Keyframe(0.5 * i, (0.25 * i * i if i < 20 else 100.0 + 10.0 * (i - 20), 0.0, 0.0), 0.0) for i in range(41)]
    kept = thinned(every)
    assert len(kept) <= 22
    times = [key.time_s for key in kept]
    for key in every:
        assert np.interp(key.time_s, times, [item.position[0] for item in kept]) == pytest.approx(
            key.position[0], abs=1e-3
        )
