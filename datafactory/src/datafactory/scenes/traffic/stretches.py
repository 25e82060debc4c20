"""Straight stretches of free ground: where a road runs, and where vehicles could drive without turning.

A mesh that does not turn keeps whatever was found of its shape at every time (:mod:`datafactory.scenes.motion`); one
that turns is searched for edges, corners and curved surfaces anew in every frame. Traffic therefore drives straight,
and a road is a straight stretch. Candidates are points in the middle of the free ground, each with the heading in
which a strip of a given width goes on for the longest.

What a road has across, and how its traffic goes round: docs/populate.md. With y to the left of a road's heading, those
who drive along it keep to y < 0. Widths are those of a street in a town (RASt 06): lanes of 3.5 m, 3 m where there is
one; a strip of 2.1 m to park in. Distances along a line are kept for ever, round its end too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from datafactory.scenes.ground import CLEARANCE_M, Ground
from datafactory.scenes.motion import Real, Track, Vector, triple
from datafactory.scenes.streets import SHARES, Mask
from datafactory.scenes.things import Strip

WIDTHS_M = (7.9, 5.6, 3.9)
"""Half widths that a road needs: with parked cars on both sides of two lanes, with two lanes, with one."""
WORTH = (1.0, 0.9, 0.6)
"""Of a metre of each."""
HEADINGS = 72
CANDIDATES = 400
REACH_M = 60
"""How far a stretch goes on to either side of its candidate, at most."""
SHORTEST_M = 36.0
WIDEST_M = 10.0
"""From its middle a road takes no more, however open the ground is."""
APART_M = 3.0
"""Between two stretches."""
UNEVEN_M = 0.1
"""How far the ground may be off a plane where vehicles drive."""


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
class Room:
    """What roads may be as wide as, to either side of their middle [m].

    :param least: the most worth first; :param most: however open the ground is
    :param beside: as much of it may lie off the road where roads are named: of two lanes, which take 5.6 m, 3 m
    """

    least: tuple[float, ...]
    most: float
    beside: float


USUAL = Room(WIDTHS_M, WIDEST_M, 3.0)
NARROW = Room((2.0,), 2.0, 0.8)
"""A lane alone, without kerb, furniture and walkers: what trees and parked cars leave."""


@dataclass(frozen=True)
class Stretch:
    """A straight piece of road.

    :param strip: its place, as wide as it is free
    :param plane: height [m] of its middle, and its slopes along and to the left
    :param region: of the split that its middle belongs to, see :class:`Ground`
    """

    strip: Strip
    plane: tuple[float, float, float]
    region: int

    def point(self, along: float, left: float) -> Real:
        """[3] world place on its plane [m]."""
        z = self.plane[0] + self.plane[1] * along + self.plane[2] * left
        return np.array([*self.strip.places(np.asarray(along), np.asarray(left)), z])

    def axes(self, turn_rad: float) -> Real:
        """[3, 3] rows ahead, left and up of what stands on its plane, turned to the left of its heading."""
        heading = self.strip.heading_rad + turn_rad
        ahead = self.plane[1] * np.cos(turn_rad) + self.plane[2] * np.sin(turn_rad)
        aside = self.plane[2] * np.cos(turn_rad) - self.plane[1] * np.sin(turn_rad)
        return tilted(heading, float(ahead), float(aside))


def tilted(heading_rad: float, slope_ahead: float, slope_left: float) -> Real:
    """[3, 3] rows ahead, left and up of what stands on a plane with these slopes."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    ahead = np.array([cosine, sine, slope_ahead]) / np.hypot(1.0, slope_ahead)
    up = np.cross(ahead, [-sine, cosine, slope_left])
    up /= length_of(up)
    return np.stack([ahead, np.cross(up, ahead), up])


def length_of(vector: Real) -> float:
    """Of a vector [n], with the same bits on every processor.

    Each square is added as by a fused multiply-add, rounded once: so OpenBLAS sums where the processor has AVX-512,
    on which the scenes of the shipped networks' records were made, and otherwise elsewhere.
    """
    squares = Fraction(0)
    for value in vector.tolist():
        squares = Fraction(float(Fraction(value) ** 2 + squares))
    return math.sqrt(squares)


def clear_width(ground: Ground, blocked: Mask) -> Real:
    """[nx, ny] radius [m] of the circle around a cell's middle in which nothing stands and no edge is."""
    free = np.pad(ground.free & ~blocked, 1)
    away: Real = ndimage.distance_transform_edt(free)[1:-1, 1:-1] * ground.cell_m
    return np.where(away > 0.0, away - np.sqrt(0.5) * ground.cell_m + CLEARANCE_M, 0.0)


def road_width(ground: Ground, beside_m: float) -> Real:
    """[nx, ny] half width [m] that a road may have around a cell's middle by what is named as roads, 0 off these.

    What stands on a road bounds it no more than :func:`clear_width` says: only free ground beside it does.
    """
    off = ground.free & ~ground.road
    if not (ground.road.any() and off.any()):
        return np.full(off.shape, np.inf)
    paved: Real = ndimage.distance_transform_edt(~off) * ground.cell_m
    return np.where(off, 0.0, paved + beside_m)


def find_stretches(
    ground: Ground, blocked: Mask, wanted_m: float, rng: np.random.Generator,
    room: Room = USUAL, found: Sequence[Stretch] = (),
) -> tuple[Stretch, ...]:  # fmt: skip
    """Stretches of road of a total length, in every split's region as its share.

    :param blocked: [nx, ny] where none may be, though it is free
    :param wanted_m: total length; less is found where there is no more
    :param found: those that there are, to which others are added
    """
    width = clear_width(ground, blocked)
    ridge = ground.street & (width >= room.least[-1]) & (width >= ndimage.maximum_filter(width, 3))
    cells = np.argwhere(ridge)
    if not len(cells):
        return tuple(found)
    cells = cells[rng.permutation(len(cells))[:CANDIDATES]]
    worths = _candidates(ground, np.minimum(width, road_width(ground, room.beside)), cells, room)
    strips = [strip for _, strip in sorted(worths, key=lambda item: -item[0] * rng.uniform(0.75, 1.0))]
    chosen: list[Stretch] = [*found]
    left_over: list[Strip] = []
    lengths = [sum(item.strip.length_m for item in found if item.region == region) for region in range(len(SHARES))]
    for strip in strips:
        region = _region(ground, strip)
        if region < 0 or lengths[region] >= wanted_m * SHARES[region] / sum(SHARES):
            left_over.append(strip)
        elif (stretch := _fitting(ground, strip, region, chosen)) is not None:
            chosen.append(stretch)
            lengths[region] += stretch.strip.length_m
    for strip in left_over:
        if sum(item.strip.length_m for item in chosen) >= wanted_m:
            break
        if (stretch := _fitting(ground, strip, _region(ground, strip), chosen)) is not None:
            chosen.append(stretch)
    return tuple(chosen)


def _candidates(ground: Ground, width: Real, cells: NDArray[np.int64], room: Room) -> list[tuple[float, Strip]]:
    """The best strip through each cell, with its worth; those that are too short left out."""
    heading = np.pi * np.arange(HEADINGS) / HEADINGS
    along = np.arange(-REACH_M, REACH_M + 1)
    middle = np.array(ground.origin) + (cells + 0.5) * ground.cell_m
    x = middle[:, 0, None, None] + along * np.cos(heading)[:, None]
    y = middle[:, 1, None, None] + along * np.sin(heading)[:, None]
    free = ground.values_at(width, x, y)
    best: list[tuple[float, Strip] | None] = [None] * len(cells)
    for least, worth in zip(room.least, WORTH, strict=False):
        wide = free >= least
        ahead = np.logical_and.accumulate(wide[..., REACH_M:], axis=-1).sum(axis=-1) - 1
        behind = np.logical_and.accumulate(wide[..., REACH_M::-1], axis=-1).sum(axis=-1) - 1
        length = ahead + behind
        which = length.argmax(axis=1)
        for n, k in enumerate(which):
            metres = float(length[n, k])
            if metres < SHORTEST_M or (best[n] is not None and best[n][0] >= worth * metres):  # type: ignore[index]
                continue
            shift = 0.5 * (ahead[n, k] - behind[n, k])
            run = free[n, k, REACH_M - behind[n, k] : REACH_M + ahead[n, k] + 1]
            x0, y0 = (middle[n] + shift * np.array([np.cos(heading[k]), np.sin(heading[k])])).tolist()
            best[n] = (worth * metres, Strip((x0, y0), float(heading[k]), metres, min(float(run.min()), room.most)))
    return [item for item in best if item is not None]


def _region(ground: Ground, strip: Strip) -> int:
    i, j = ground.cell_of(np.array(strip.middle[0]), np.array(strip.middle[1]))
    return int(ground.region[int(i), int(j)])


def _fitting(ground: Ground, strip: Strip, region: int, others: Sequence[Stretch]) -> Stretch | None:
    """The strip as a road, shorter where the ground bends; None where it is in another's way or too uneven."""
    if any(strip.overlaps(other.strip, APART_M) for other in others):
        return None
    half = min(strip.half_width_m - CLEARANCE_M, 3.0)
    while strip.length_m >= SHORTEST_M:
        plane = plane_under(ground, replace(strip, half_width_m=half), (41, 5), UNEVEN_M)
        if plane is not None:
            return Stretch(strip, plane, region)
        strip = replace(strip, length_m=0.7 * strip.length_m)
    return None


def plane_under(ground: Ground, strip: Strip, points: tuple[int, int], uneven_m: float) -> Vector | None:
    """Height [m] of a strip's middle, and the slopes along it and to its left, by least squares.

    :param points: along and across, at which the ground is looked at
    :param uneven_m: how far it may be off the plane there; None beyond, and where there is no ground
    """
    half = 0.5 * strip.length_m, strip.half_width_m
    along, left = (axis.ravel() for axis in np.meshgrid(*(
        reach * np.linspace(-1.0, 1.0, count) for reach, count in zip(half, points, strict=True)
    )))  # fmt: skip
    z = ground.heights_at(*strip.places(along, left))
    if not np.isfinite(z).all():
        return None
    # The places lie on a grid about the middle, on which the three unknowns are orthogonal. Sums that are rounded once
    # have the same bits on every processor, those of a linear algebra library have not.
    level = math.fsum(z.tolist()) / z.size
    rise, tilt = (math.fsum((axis * z).tolist()) / math.fsum((axis * axis).tolist()) for axis in (along, left))
    off = np.abs(level + rise * along + tilt * left - z)
    return (level, rise, tilt) if off.max() <= uneven_m else None


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
        return triple(np.array(self.start) + at_m * np.array(self.ahead))

    def track(self, at_m: float) -> Track:
        """How something moves that is ``at_m`` along the line at time 0, from 0 to below its length."""
        leaps = int(np.ceil((at_m + self.speed_mps * HORIZON_S) / self.length_m)) - 1
        leap_s = (self.length_m * np.arange(1, leaps + 1) - at_m) / self.speed_mps
        back, last = -at_m, at_m + self.speed_mps * HORIZON_S - leaps * self.length_m - at_m
        times = (0.0, *(float(time) for time in leap_s), HORIZON_S)
        shifts = (0.0, *(back for _ in leap_s), last)
        velocity, ahead = triple(self.speed_mps * np.array(self.ahead)), np.array(self.ahead)
        places = tuple(triple(shift * ahead) for shift in shifts)
        return Track(times, places, (*(velocity for _ in times[:-1]), (0.0, 0.0, 0.0)))


def spaced(count: int, length_m: float, least_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """[count] places along a closed line [m], rising, no two nearer than ``least_m``, the rest of it shared at random.

    :param length_m: at least ``count * least_m``
    """
    rest = length_m - count * least_m
    gaps = least_m + rest * rng.dirichlet(np.full(count, 4.0)) if count else np.zeros(0)
    places: NDArray[np.float64] = (rng.uniform(0.0, length_m) + np.cumsum(gaps)) % length_m
    return np.sort(places)
