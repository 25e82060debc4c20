"""The lanes of a city's streets, and the turns between them: polylines that vehicles follow. Traffic keeps right."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.plan import Plan, Street

STOP_BEFORE_M = 1.0
"""Between the stop line and the pedestrians' crossing before it."""
TURN_STEPS = 12


@dataclass(eq=False)
class Way:
    """A polyline that vehicles follow one behind the other.

    :param points: [n, 2] (x, y) [m]
    :param stops: where along it vehicles stop at a red light [m], and the phase in which that light is green; None for
        a light that stays red
    :param onto: ways that can follow, each from a place along this one [m], and where along that one it joins [m]
    """

    points: NDArray[np.float64]
    stops: list[tuple[float, int | None]] = field(default_factory=list)
    onto: list[tuple[float, Way, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        self.along = np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        return float(self.along[-1])

    def at(self, along: float) -> tuple[float, float, float]:
        """(x, y, heading [degree]) at a distance along it; straight on beyond its ends."""
        piece = int(np.clip(np.searchsorted(self.along, along, side="right") - 1, 0, len(self.points) - 2))
        start, step = self.points[piece], self.points[piece + 1] - self.points[piece]
        length = self.along[piece + 1] - self.along[piece]
        x, y = start + step * ((along - self.along[piece]) / length)
        return float(x), float(y), math.degrees(math.atan2(step[1], step[0]))


def lanes_of(plan: Plan, turns: bool) -> list[Way]:
    """The lanes of all streets, each way as long as its street; those that turn right come with their arcs.

    Lights give the streets along x green in phase 0, those along y in phase 1. Where a street ends at a crossing, its
    traffic waits.

    :param turns: whether the outermost lanes of streets along x lead right into the streets that they cross
    """
    lanes: dict[tuple[Street, float, int], Way] = {}
    for street in plan.streets:
        for direction in (1.0, -1.0):
            for index in range(street.kind.lanes):
                aside = -direction * (street.kind.median_m + (index + 0.5) * street.kind.lane_m)
                ends = (street.start, street.end) if direction > 0.0 else (street.end, street.start)
                way = Way(np.array([street.point(end, aside) for end in ends]))
                for at, other in plan.crossings_of(street):
                    clear = other.kind.facade + 3.0 + STOP_BEFORE_M
                    stop = direction * (at - ends[0]) - clear
                    leads_on = abs(ends[1] - at) > 1.0
                    if stop > 0.0:
                        way.stops.append((stop, (0 if street.axis == "x" else 1) if leads_on else None))
                way.stops.sort(key=lambda pair: pair[0])
                lanes[street, direction, index] = way
    if turns:
        for crossing in plan.crossings:
            for direction in (1.0, -1.0):
                _add_turn(lanes, crossing.along_x, crossing.along_y, direction)
    return list(lanes.values())


def _radius(from_one: float, from_other: float) -> float:
    """The largest radius [m] of a right turn that keeps a car of 2 m off the corner of the kerbs.

    :param from_one, from_other: from the middle of either lane to its kerb [m]
    """
    fits = [
        radius
        for radius in np.arange(2.0, 12.0, 0.25).tolist()
        if math.hypot(max(radius - from_one, 0.0), max(radius - from_other, 0.0)) <= radius - 1.0
    ]
    return max(fits, default=2.0)


def _add_turn(lanes: dict[tuple[Street, float, int], Way], street: Street, other: Street, direction: float) -> None:
    """The right turn from the outermost lane of a street along x into that of one along y, if it leads there.

    Eastbound traffic leaves to the south, westbound to the north.
    """
    goes_on = other.start < street.at - 10.0 if direction > 0.0 else other.end > street.at + 10.0
    if not goes_on:
        return
    source = lanes[street, direction, street.kind.lanes - 1]
    target = lanes[other, -direction, other.kind.lanes - 1]
    x, y = target.points[0][0], source.points[0][1]
    radius = _radius(abs(x - other.at + direction * other.kind.kerb), abs(y - street.at + direction * street.kind.kerb))
    angle = np.linspace(0.0, 0.5 * np.pi, TURN_STEPS + 1)
    arc = np.column_stack(
        [x - direction * radius * (1.0 - np.sin(angle)), y - direction * radius * (1.0 - np.cos(angle))]
    )
    leaves = abs(arc[0][0] - source.points[0][0])
    joins = abs(arc[-1][1] - target.points[0][1])
    turn = Way(arc)
    turn.onto.append((turn.length, target, joins))
    source.onto.append((leaves, turn, 0.0))
