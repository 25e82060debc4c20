"""What moves in a city: vehicles in the lanes, cars in car parks, people on pavements and crossings, cyclists."""

from __future__ import annotations

import numpy as np

from datafactory.scenes.city import works
from datafactory.scenes.city.chance import drawn
from datafactory.scenes.city.lanes import Way, lanes_of
from datafactory.scenes.city.placement import Keyframe
from datafactory.scenes.city.plan import Plan, Street
from datafactory.scenes.city.rules import Rules
from datafactory.scenes.city.site import Site
from datafactory.scenes.city.traffic import CLEARING_S, DURATION_S, GREEN_S, Vehicle, drive

LENGTHS = {"Saloon": 4.6, "Hatchback": 4.0, "Van": 5.0, "Lorry": 9.0, "Bus": 11.5, "Cyclist": 1.8}
KINDS = {"Lorry": ("Lorries", "Lorry"), "Bus": ("Buses", "Bus"), "Cyclist": ("People", "Cyclist")}
TURNING = 0.3
"""Share of the cars that turn right at the next crossing where they can."""
TURN = ("Saloon", "Hatchback")
CYCLISTS = 0.06
"""Share of cyclists among the vehicles; cars stay behind them."""
AISLE_MPS = 2.5


def populate(site: Site, plan: Plan, rules: Rules) -> None:
    """Everything that moves, as keyframes over the first DURATION_S of the scene."""
    _vehicles(site, plan, rules)
    _cars_in_aisles(site, plan, rules)
    if rules.walkers:
        for street in plan.streets:
            for first, last in plan.stretches(street):
                _walkers(site, street, first, last, rules)
        _crossing_people(site, plan, rules)


def _vehicles(site: Site, plan: Plan, rules: Rules) -> None:
    rng = site.rng
    vehicles: list[Vehicle] = []
    for way in lanes_of(plan, turns=True):
        along, busy = rng.uniform(6.0, 30.0), not way.onto and way.stops and rng.random() < 0.3
        while along < way.length - 8.0 and not busy:
            heavy, cyclist = rng.random() < rules.heavy, rng.random() < CYCLISTS * bool(rules.walkers)
            model = "Lorry" if heavy and rng.random() < 0.7 else "Bus" if heavy else "Cyclist" if cyclist else ""
            model = model or drawn(rng, (("Saloon", 0.42), ("Hatchback", 0.42), ("Van", 0.16)))
            length = LENGTHS[model]
            speed = rng.uniform(*rules.speed_mps) * (0.75 if heavy else 1.0)
            speed = min(speed, 5.5) if model == "Cyclist" else speed
            if _clear_of_crossings(way, along, length):
                turns = [index for index, (leaves, _, _) in enumerate(way.onto) if leaves > along + 18.0]
                turns_at = turns[0] if turns and model in TURN and rng.random() < TURNING else None
                aside = 0.9 if model == "Cyclist" else 0.0
                vehicles.append(Vehicle(model, length, float(speed), way, float(along), turns_at, aside))
            along += length + rng.uniform(*rules.gap_m)
    drive(vehicles)
    for vehicle in vehicles:
        group, kind = KINDS.get(vehicle.model, ("Cars", "Car"))
        first = vehicle.keys[0]
        target, sizes = ("cyclist", (("wheel_radius_m", 0.34),)) if kind == "Cyclist" else ("", ())
        site.add(group, kind, vehicle.model, first.position, first.yaw_deg, vehicle.keys, target, sizes)


def _clear_of_crossings(way: Way, along: float, length: float) -> bool:
    """Whether a vehicle stands before a stop line or well beyond its crossing, rather than on it."""
    return all(along + 0.5 * length < stop or along - 0.5 * length > stop + CROSSED_M for stop, _ in way.stops)


CROSSED_M = 46.0
"""From a stop line to where a crossing of any kind lies behind."""


def _cars_in_aisles(site: Site, plan: Plan, rules: Rules) -> None:
    """A car in some of the aisles of car parks, looking for a place."""
    for block in plan.blocks:
        if block.use != "parking":
            continue
        for y, x0, x1 in works.aisles(block):
            if site.rng.random() < 0.35 or x1 - x0 < 30.0:
                continue
            east = site.rng.random() < 0.5
            reach = min(AISLE_MPS * DURATION_S, x1 - x0 - 8.0)
            start = x0 + 4.0 if east else x1 - 4.0
            end = start + reach if east else start - reach
            keys = _straight(
                (start, y + (-1.4 if east else 1.4)), (end, y + (-1.4 if east else 1.4)), rules.kerb_m, AISLE_MPS
            )
            site.add(
                "Cars",
                "Car",
                drawn(site.rng, (("Saloon", 0.5), ("Hatchback", 0.5))),
                keys[0].position,
                keys[0].yaw_deg,
                keys,
            )


def _straight(
    start: tuple[float, float], end: tuple[float, float], z: float, speed: float, begins_s: float = 0.0
) -> list[Keyframe]:
    """Straight from ``start`` to ``end`` (x, y) [m] at a speed [m/s]; at rest before, and from the end of that on."""
    (x0, y0), (x1, y1) = start, end
    distance = float(np.hypot(x1 - x0, y1 - y0))
    yaw = round(float(np.degrees(np.arctan2(y1 - y0, x1 - x0))), 2)
    ends_s = round(min(begins_s + distance / speed, DURATION_S), 2)
    share = (ends_s - begins_s) * speed / distance
    keys = [Keyframe(0.0, (round(x0, 3), round(y0, 3), z), yaw)]
    if begins_s > 0.0:
        keys.append(Keyframe(begins_s, keys[0].position, yaw))
    there = (round(x0 + share * (x1 - x0), 3), round(y0 + share * (y1 - y0), 3), z)
    return [*keys, Keyframe(ends_s, there, yaw)]


def _walkers(site: Site, street: Street, first: float, last: float, rules: Rules) -> None:
    """People along both pavements, in a strip that street furniture and shelters leave free."""
    rng = site.rng
    for side in (1.0, -1.0):
        for number in range(int(rng.integers(rules.walkers, endpoint=True))):
            aside = side * (street.kind.facade - 0.4 - 0.6 * number)  # side by side, so that nobody runs into another
            if number and street.kind.pavement_m < 2.9:
                continue
            speed, forwards = rng.uniform(0.9, 1.7), rng.random() < 0.5
            reach = min(speed * DURATION_S, last - first - 2.0)
            start = rng.uniform(first + 1.0, last - 1.0 - reach)
            ends = (start, start + reach) if forwards else (start + reach, start)
            keys = _straight(street.point(ends[0], aside), street.point(ends[1], aside), rules.kerb_m, speed)
            _person(site, keys)


def _person(site: Site, keys: list[Keyframe]) -> None:
    stature = round(float(site.rng.uniform(1.55, 1.9)), 2)
    site.add(
        "People", "Pedestrian", "Pedestrian", keys[0].position, keys[0].yaw_deg, keys,
        target="pedestrian", target_options=(("stature_m", stature),),
    )  # fmt: skip


def _crossing_people(site: Site, plan: Plan, rules: Rules) -> None:
    """People who wait at a street along x until its traffic has stopped, and cross it then."""
    for street, middle in plan.zebras():
        if street.axis != "x" or site.rng.random() < 0.4:
            continue
        side = 1.0 if site.rng.random() < 0.5 else -1.0
        along, reach = middle + site.rng.uniform(-0.9, 0.9), street.kind.kerb + 0.7
        begins = GREEN_S + CLEARING_S + round(float(site.rng.uniform(0.5, 2.0)), 1)
        keys = _straight(street.point(along, side * reach), street.point(along, -side * reach), 0.0, 1.5, begins)
        _person(site, keys)
