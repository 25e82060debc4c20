"""How a road is divided across, from its middle outwards: lanes, a strip to park in, kerb, pavement; and what streams.

Traffic keeps to the right. With y to the left of a road's heading, those who drive along it keep to y < 0. Widths are
those of a street in a town (RASt 06): lanes of 3.5 m, 3 m where there is one; a strip of 2.1 m to park in.

Along a line things follow each other, all with one speed. Who comes to its end begins again at its start, so that a
stream looks alike at all times and nobody catches up with anybody: distances along the line are kept for ever, round
its end too. The leap is the one thing that no vehicle does; it happens at the ends of a stretch of road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.motion import Track, Vector
from datafactory.scenes.traffic.stretches import WIDTHS_M

FURNITURE_M = 0.45
"""Poles and signs stand so far behind the kerb."""
FIRST_ROW_M = 1.1
"""The first row of walkers."""
ROW_M = 0.7
WALL_M = 0.35
"""Nobody walks nearer to what bounds the pavement."""
PAVEMENT_M = 4.0
HORIZON_S = 600.0
"""Streams run from time 0 to here, and rest before and after."""


@dataclass(frozen=True)
class Line:
    """Where a stream moves, with one speed.

    :param left_m: its place across the road; :param forward: along the road's heading, or against it
    """

    left_m: float
    forward: bool


@dataclass(frozen=True)
class Layout:
    """A road across.

    :param lanes: of vehicles; :param cycling: of cyclists; :param walking: of pedestrians
    :param parking: middles of the strips to park in; none where there are none
    :param kerb_m: from the road's middle
    """

    lanes: tuple[Line, ...]
    cycling: tuple[Line, ...]
    walking: tuple[Line, ...]
    parking: tuple[Line, ...]
    kerb_m: float


def layout_of(half_width_m: float, parked: bool, rng: np.random.Generator) -> Layout:
    """The road that fits between what stands this far from its middle on either side.

    :param parked: whether anybody parks
    """
    wide, middling, _ = WIDTHS_M
    one_way = bool(rng.random() < 0.5)
    if half_width_m >= wide and parked:
        lanes, bicycle, park, kerb = 1.75, 3.55, 5.05, 6.2
    elif half_width_m >= middling and parked and one_way:
        lanes, bicycle, park, kerb = 0.0, 1.65, 3.05, 4.1
    elif half_width_m >= middling:
        lanes, bicycle, park, kerb = 1.75, 3.55, 0.0, 4.1
    else:
        lanes, bicycle, park, kerb = 0.0, 1.65, 0.0, 2.4
    one_way = lanes == 0.0
    widest = min(half_width_m - WALL_M, kerb + PAVEMENT_M)
    rows = np.arange(kerb + FIRST_ROW_M, widest, ROW_M)
    walking = [Line(side * float(row), bool(rng.random() < 0.5)) for side in (-1.0, 1.0) for row in rows]
    return Layout(
        lanes=(Line(0.0, True),) if one_way else (Line(-lanes, True), Line(lanes, False)),
        cycling=(Line(-bicycle, True),) if one_way else (Line(-bicycle, True), Line(bicycle, False)),
        walking=tuple(walking),
        parking=(Line(-park, True), Line(park, one_way)) if park else (),
        kerb_m=kerb,
    )


@dataclass(frozen=True)
class Course:
    """A straight line that is gone along again and again.

    :param start: where it begins [m]; :param ahead: unit vector along it
    :param length_m: from one beginning to the next
    :param speed_mps: of all that follow it
    """

    start: Vector
    ahead: Vector
    length_m: float
    speed_mps: float

    def place(self, at_m: float) -> Vector:
        """So far along the line [m]."""
        x, y, z = (float(a + at_m * b) for a, b in zip(self.start, self.ahead, strict=True))
        return x, y, z

    def track(self, at_m: float) -> Track:
        """How something moves that is ``at_m`` along the line at time 0, from 0 to below its length."""
        leaps = int(np.ceil((at_m + self.speed_mps * HORIZON_S) / self.length_m)) - 1
        leap_s = (self.length_m * np.arange(1, leaps + 1) - at_m) / self.speed_mps
        x, y, z = (float(self.speed_mps * part) for part in self.ahead)
        back, last = -at_m, at_m + self.speed_mps * HORIZON_S - leaps * self.length_m - at_m
        times = (0.0, *(float(time) for time in leap_s), HORIZON_S)
        shifts = (0.0, *(back for _ in leap_s), last)
        places = tuple((float(s * self.ahead[0]), float(s * self.ahead[1]), float(s * self.ahead[2])) for s in shifts)
        return Track(times, places, (*((x, y, z) for _ in times[:-1]), (0.0, 0.0, 0.0)))


def spaced(count: int, length_m: float, least_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """[count] places along a closed line [m], rising, no two nearer than ``least_m``, the rest of it shared at random.

    :param length_m: at least ``count * least_m``
    """
    rest = length_m - count * least_m
    gaps = least_m + rest * rng.dirichlet(np.full(count, 4.0)) if count else np.zeros(0)
    places: NDArray[np.float64] = (rng.uniform(0.0, length_m) + np.cumsum(gaps)) % length_m
    return np.sort(places)
