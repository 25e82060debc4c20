"""Cities by their meshes: no body in another, at rest or in traffic, and vehicles between the kerbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scene_solids import CitySolids
from solids import intersecting

from datafactory.scenes.city.city import city
from datafactory.scenes.city.options import CityOptions
from datafactory.scenes.city.placement import Placement
from datafactory.scenes.city.plan import Rectangle, draw_plan
from datafactory.scenes.city.rules import RULES
from datafactory.scenes.city.style import Style
from datafactory.scenes.city.traffic import DURATION_S

SEED = 2
STEP_S = 0.5
"""Nobody drives further than its own length in it, but for the fastest on the motorway, who meet nobody."""
INWARDS_M = 0.3
"""So far a corner of a vehicle that turns may swing over a kerb."""
ON_WHEELS = ("Cars/", "Lorries/", "Buses/")


@lru_cache  # of every style: each test asks for all of them
def placements_of(style: Style) -> tuple[Placement, ...]:
    return city(CityOptions(seed=SEED, style=style, blocks=2))


@pytest.mark.parametrize("style", list(Style))
def test_no_body_is_in_another_at_any_time(style: Style) -> None:
    """Walkers, cyclists and vehicles among themselves, and against all that stands; test_city.py holds other seeds."""
    solids = CitySolids(placements_of(style))
    assert len(solids.placements) > 100
    assert intersecting(solids.at(0.0)) == []
    for time_s in np.arange(0.0, DURATION_S + 0.1, STEP_S):
        assert intersecting(solids.at(time_s), moving_only=True) == [], time_s


def test_a_body_in_another_would_be_found() -> None:
    """A car that is driven into the middle of a house."""
    placements = placements_of(Style.OLD_TOWN)
    moving = next(item for item in placements if item.path.startswith("Cars/") and item.keyframes)
    house = next(thing for thing in CitySolids(placements).at(0.0) if thing.name.startswith("Houses/"))
    x, y, _ = (house.shape.corners.mean(axis=(0, 1)) @ house.turn.T + house.place).tolist()
    keys = (moving.keyframes[0], replace(moving.keyframes[-1], time_s=DURATION_S, position=(x, y, 0.5)))
    driven = [replace(item, keyframes=keys) if item is moving else item for item in placements]
    (pair,) = intersecting(CitySolids(driven).at(DURATION_S), moving_only=True)
    assert set(pair[:2]) == {moving.path, house.name}
    assert pair[2] > 0.1


def holds(areas: Sequence[Rectangle], places: np.ndarray, beyond_m: float = 0.0) -> np.ndarray:
    """[n] whether places [n, 3] are over one of the areas, or within so much of it."""
    limits = np.array([(area.x0, area.y0, area.x1, area.y1) for area in areas]).reshape(-1, 4)[:, None]
    low, high = limits[..., :2] - beyond_m, limits[..., 2:] + beyond_m
    return np.asarray(((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=2).any(axis=0))


@pytest.mark.parametrize("style", list(Style))
def test_vehicles_keep_between_the_kerbs(style: Style) -> None:
    """Every corner of what drives, at all times, is over the carriageway of some street, or over a car park."""
    plan = draw_plan(np.random.default_rng(SEED), RULES[style], 2)
    roads = [street.strip(street.kind.kerb) for street in plan.streets]
    whole = Rectangle(  # who leaves it goes on beyond the end of its street
        min(road.x0 for road in roads), min(road.y0 for road in roads),
        max(road.x1 for road in roads), max(road.y1 for road in roads),
    )  # fmt: skip
    parks = [block.area for block in plan.blocks if block.use == "parking"]
    driving = [item for item in placements_of(style) if item.keyframes and item.path.startswith(ON_WHEELS)]
    assert driving
    solids = CitySolids(driving)
    for time_s in np.arange(0.0, DURATION_S + 0.1, STEP_S):
        things = solids.at(time_s)
        corners = [thing.shape.corners.reshape(-1, 3) @ thing.turn.T + thing.place for thing in things]
        off = [
            thing.name
            for thing, places in zip(things, corners, strict=True)
            if not (holds(roads, places, INWARDS_M) | holds(parks, places) | ~holds([whole], places)).all()
        ]
        assert off == [], time_s


@pytest.mark.parametrize("style", list(Style))
def test_who_drives_straight_on_keeps_its_lane_to_the_right(style: Style) -> None:
    """At every keyframe: on one line along a street, to the right of its middle, never backwards."""
    plan = draw_plan(np.random.default_rng(SEED), RULES[style], 2)
    followed = 0
    for item in placements_of(style):
        keys = item.keyframes
        if not item.path.startswith(ON_WHEELS) or not keys or any(key.yaw_deg != keys[0].yaw_deg for key in keys):
            continue
        places = np.array([key.position[:2] for key in keys])
        ahead = np.round([np.cos(np.radians(keys[0].yaw_deg)), np.sin(np.radians(keys[0].yaw_deg))])
        right = np.array([ahead[1], -ahead[0]])
        assert np.ptp(places @ right) < 0.002, item.path
        assert (np.diff(places @ ahead) >= -0.001).all(), item.path
        for street in plan.streets:
            along = (street.axis == "x") == bool(ahead[0])
            if along and street.strip(street.kind.kerb).holds(*places[0].tolist()):
                followed += 1
                middle = np.array([0.0, street.at] if street.axis == "x" else [street.at, 0.0])
                assert (places[0] - middle) @ right > 0.5 * street.kind.lane_m - 0.01, item.path
    assert followed > 3
