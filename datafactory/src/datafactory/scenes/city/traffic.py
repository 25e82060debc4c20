"""Vehicles that follow each other along lanes, stop at red lights and turn: the intelligent driver model.

Treiber, Hennecke, Helbing, *Congested traffic states in empirical observations and microscopic simulations*, Phys. Rev.
E 62 (2000), eq. (1) to (3): with speed v, wanted speed v0, gap s to the one ahead and closing speed dv,

    dv/dt = a (1 - (v / v0)^4 - (s* / s)^2),    s* = s0 + max(0, v T + v dv / (2 sqrt(a b))).

A red light is a standing vehicle of no length at the stop line, for those who can stop with 4 m/s^2. The streets along
x have green first, then all have red until the crossings are clear, then those along y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from datafactory.scenes.city.lanes import Way
from datafactory.scenes.city.placement import Keyframe

STEP_S = 0.1
SAMPLE_STEPS = 5
ACCELERATION, COMFORTABLE, HEADWAY_S, STANDING_GAP_M = 1.4, 2.0, 1.3, 2.5
"""a, b, T and s0 of the model, for city traffic."""
BRAKING = 4.0
TURNING_MPS = 3.0
GREEN_S, CLEARING_S = 9.0, 4.0
DURATION_S = 24.0
LOOK_AHEAD_M = 80.0
STRAIGHT_M = 5e-4
"""A keyframe that lies within this of the line between its neighbours is left out."""


@dataclass(eq=False)
class Vehicle:
    """One vehicle on its way.

    :param model: name of its shape
    :param length: of its body [m], its middle at ``along``
    :param wanted_mps: speed on a free road
    :param way, along: where it is
    :param turns_at: index into the way's ``onto`` that it takes; None for straight on
    :param aside: to the right of the way [m]
    """

    model: str
    length: float
    wanted_mps: float
    way: Way
    along: float
    turns_at: int | None = None
    aside: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    keys: list[Keyframe] = field(default_factory=list)


def phase_at(time_s: float) -> int | None:
    """Which phase has green: 0, 1, or None while all have red."""
    within = time_s % (2.0 * (GREEN_S + CLEARING_S))
    if within < GREEN_S:
        return 0
    if GREEN_S + CLEARING_S <= within < 2.0 * GREEN_S + CLEARING_S:
        return 1
    return None


def drive(vehicles: list[Vehicle], duration_s: float = DURATION_S) -> None:
    """Move the vehicles through time; each has its keyframes then, one every half second and at both ends.

    The same vehicles end in the same keyframes.
    """
    for vehicle in vehicles:
        vehicle.speed = vehicle.wanted_mps
    _settle(vehicles)
    steps = round(duration_s / STEP_S)
    for step in range(steps + 1):
        if step % SAMPLE_STEPS == 0:
            for vehicle in vehicles:
                _note(vehicle, step * STEP_S)
        phase = phase_at(step * STEP_S)
        for vehicle in vehicles:
            vehicle.acceleration = _acceleration(vehicle, vehicles, phase)
        for vehicle in vehicles:
            _advance(vehicle)
    for vehicle in vehicles:
        vehicle.keys = thinned(vehicle.keys)


def _settle(vehicles: list[Vehicle]) -> None:
    """Speeds from which all can stop behind the one ahead or at their light: nobody begins with hard braking."""
    for vehicle in vehicles:
        gap, ahead = _gap(vehicle, vehicles, phase_at(0.0), can_always_stop=True)
        reach = max(0.0, gap - STANDING_GAP_M)
        vehicle.speed = min(
            vehicle.wanted_mps, math.sqrt(2.0 * COMFORTABLE * reach) + (0.5 * ahead if gap > 8 else 0.0)
        )


def _acceleration(vehicle: Vehicle, vehicles: list[Vehicle], phase: int | None) -> float:
    wanted = vehicle.wanted_mps
    if vehicle.turns_at is not None:
        to_turn = vehicle.way.onto[vehicle.turns_at][0] - vehicle.along
        wanted = min(wanted, math.sqrt(TURNING_MPS * TURNING_MPS + 2.0 * 1.5 * max(0.0, to_turn)))
    elif len(vehicle.way.points) > 2:
        wanted = min(wanted, TURNING_MPS)
    v, ratio = vehicle.speed, vehicle.speed / wanted
    free = 1.0 - ratio * ratio * ratio * ratio
    gap, ahead = _gap(vehicle, vehicles, phase)
    if gap < LOOK_AHEAD_M:
        closing = v * (v - ahead) / (2.0 * math.sqrt(ACCELERATION * COMFORTABLE))
        share = (STANDING_GAP_M + max(0.0, v * HEADWAY_S + closing)) / max(gap, 0.1)
        free -= share * share
    return max(-8.0, ACCELERATION * free)


def _gap(
    vehicle: Vehicle, vehicles: list[Vehicle], phase: int | None, can_always_stop: bool = False
) -> tuple[float, float]:
    """Free way ahead [m] up to LOOK_AHEAD_M, and the speed of what ends it [m/s]."""
    nearest, ahead = LOOK_AHEAD_M, 0.0
    front = vehicle.along + 0.5 * vehicle.length
    for stop, green in vehicle.way.stops:
        beyond_turn = vehicle.turns_at is not None and stop > vehicle.way.onto[vehicle.turns_at][0]
        gap = stop - front
        if (green is not None and green == phase) or gap < -0.5 or beyond_turn:
            continue
        if can_always_stop or vehicle.speed * vehicle.speed <= 2.0 * BRAKING * max(gap, 0.1):
            nearest = min(nearest, gap + STANDING_GAP_M)  # the model keeps its standing gap: up to the line, not before
    # The ways that it will follow: (way, how far away the way's origin is).
    follows = [(vehicle.way, -vehicle.along)]
    way, index, origin = vehicle.way, vehicle.turns_at, -vehicle.along
    while True:
        index = 0 if index is None and len(way.points) > 2 and way.onto else index
        if index is None:
            break
        leaves, following, joins = way.onto[index]
        origin = origin + leaves - joins
        follows.append((following, origin))
        way, index = following, None
    for other in vehicles:
        if other is vehicle:
            continue
        for number, (followed, origin) in enumerate(follows):
            if other.way is not followed:
                continue
            distance = origin + other.along
            # On a way that it has not reached yet, what is behind the place where it joins lets it in.
            joined = number == 0 or distance > 0.0
            gap = distance - 0.5 * (vehicle.length + other.length)
            if joined and distance > 0.0 and gap < nearest:
                nearest, ahead = gap, other.speed
    return nearest, ahead


def _advance(vehicle: Vehicle) -> None:
    speed = max(0.0, vehicle.speed + vehicle.acceleration * STEP_S)
    vehicle.along += 0.5 * (vehicle.speed + speed) * STEP_S
    vehicle.speed = speed
    if vehicle.turns_at is not None:
        leaves, following, joins = vehicle.way.onto[vehicle.turns_at]
        if vehicle.along >= leaves:
            vehicle.way, vehicle.along, vehicle.turns_at = following, joins + vehicle.along - leaves, None
    if vehicle.turns_at is None and len(vehicle.way.points) > 2 and vehicle.way.onto:
        leaves, following, joins = vehicle.way.onto[0]
        if vehicle.along >= leaves:
            vehicle.way, vehicle.along = following, joins + vehicle.along - leaves


def _note(vehicle: Vehicle, time_s: float) -> None:
    x, y, yaw = vehicle.way.at(vehicle.along)
    x += vehicle.aside * math.sin(math.radians(yaw))
    y -= vehicle.aside * math.cos(math.radians(yaw))
    if vehicle.keys:
        yaw += 360.0 * round((vehicle.keys[-1].yaw_deg - yaw) / 360.0)
    vehicle.keys.append(Keyframe(round(time_s, 2), (round(x, 3), round(y, 3), 0.0), round(yaw, 2)))


def thinned(keys: list[Keyframe]) -> list[Keyframe]:
    """The keyframes without those that lie on the lines between the others."""
    kept, first = keys[:1], 0
    for last in range(2, len(keys)):
        if not all(_between(keys[first], key, keys[last]) for key in keys[first + 1 : last]):
            kept.append(keys[last - 1])
            first = last - 1
    return [*kept, keys[-1]]


def _between(before: Keyframe, key: Keyframe, after: Keyframe) -> bool:
    share = (key.time_s - before.time_s) / (after.time_s - before.time_s)
    places = zip(before.position, key.position, after.position, strict=True)
    off = max(abs(start + share * (end - start) - here) for start, here, end in places)
    turned = abs(before.yaw_deg + share * (after.yaw_deg - before.yaw_deg) - key.yaw_deg)
    return off <= STRAIGHT_M and turned <= 0.01
