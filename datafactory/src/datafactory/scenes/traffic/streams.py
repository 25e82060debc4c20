"""Streams: things that follow each other along a straight line, all with one speed.

Who comes to the line's end begins again at its start, so that a stream looks alike at all times and nobody catches up
with anybody: distances along the line are kept for ever, round its end too. The leap is the one thing that no vehicle
does; it happens at the ends of a stretch of road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.motion import Track, Vector

Real = NDArray[np.float64]

HORIZON_S = 600.0
"""Streams run from time 0 to here, and rest before and after."""


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


def spaced(count: int, length_m: float, least_m: float, rng: np.random.Generator) -> Real:
    """[count] places along a closed line [m], rising, no two nearer than ``least_m``, the rest of it shared at random.

    :param length_m: at least ``count * least_m``
    """
    rest = length_m - count * least_m
    gaps = least_m + rest * rng.dirichlet(np.full(count, 4.0)) if count else np.zeros(0)
    places: Real = (rng.uniform(0.0, length_m) + np.cumsum(gaps)) % length_m
    return np.sort(places)
