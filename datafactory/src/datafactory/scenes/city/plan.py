"""The plan of a city: streets, crossings and blocks, as rectangles along the axes.

The main street lies along x at y = 0. Rows of blocks lie on both of its sides; parallel side streets between further
rows, cross streets along y between neighbouring columns. A cross street may end at the main street: a T. Signs and
parked cars face as traffic does that keeps to the right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datafactory.scenes.city.rules import Rules, StreetKind, drawn

REACH_M = 24.0
"""Streets and ground go on this far beyond the last block."""
ZEBRA_M = 3.0
"""Width of a pedestrians' crossing; it begins at the facade line of the street that is crossed."""


@dataclass(frozen=True)
class Rectangle:
    """From (x0, y0) to (x1, y1) [m]."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        return self.y1 - self.y0

    def inset(self, by: float) -> Rectangle:
        return Rectangle(self.x0 + by, self.y0 + by, self.x1 - by, self.y1 - by)


@dataclass(frozen=True)
class Street:
    """A straight street.

    :param axis: ``"x"`` or ``"y"``, along which it runs
    :param at: the other coordinate of its centre line [m]
    :param start, end: along the axis [m]
    :param kind: its cross section
    """

    axis: str
    at: float
    start: float
    end: float
    kind: StreetKind

    def point(self, along: float, aside: float, z: float) -> tuple[float, float, float]:
        """World place of a point of it: ``aside`` is positive to the left of the axis' direction [m]."""
        return (along, self.at + aside, z) if self.axis == "x" else (self.at - aside, along, z)

    def strip(self, half_width: float) -> Rectangle:
        """The rectangle within ``half_width`` of the centre line."""
        if self.axis == "x":
            return Rectangle(self.start, self.at - half_width, self.end, self.at + half_width)
        return Rectangle(self.at - half_width, self.start, self.at + half_width, self.end)

    @property
    def yaw_deg(self) -> float:
        """Heading along the axis."""
        return 0.0 if self.axis == "x" else 90.0


@dataclass(frozen=True)
class Block:
    """A plot between streets.

    :param area: from facade line to facade line
    :param use: what it is used for, a name of ``Rules.uses``
    :param fronts: its sides along streets: ``"north"``, ``"south"``, ``"east"``, ``"west"``
    """

    area: Rectangle
    use: str
    fronts: frozenset[str]


@dataclass(frozen=True)
class Frontage:
    """One side of a block as a frame of its own, so that one builder serves all four.

    Its x runs along the side, to the right for somebody who stands in the street and looks at the block; its y runs
    into the block. That is the frame of :mod:`datafactory.scenes.city.buildings`, whose front faces -y.

    :param x, y: of its origin, the left end seen from the street [m]
    :param length: [m]
    :param yaw_deg: of its x axis
    """

    x: float
    y: float
    length: float
    yaw_deg: float

    def place(self, along: float, inwards: float, z: float = 0.0) -> tuple[float, float, float]:
        """World place of a point ``along`` the side and ``inwards`` of it [m]."""
        cosine, sine = round(math.cos(math.radians(self.yaw_deg))), round(math.sin(math.radians(self.yaw_deg)))
        return self.x + cosine * along - sine * inwards, self.y + sine * along + cosine * inwards, z


def frontage(area: Rectangle, side: str) -> Frontage:
    """The side of a rectangle: ``"south"``, ``"east"``, ``"north"`` or ``"west"``."""
    return {
        "south": Frontage(area.x0, area.y0, area.width, 0.0),
        "east": Frontage(area.x1, area.y0, area.depth, 90.0),
        "north": Frontage(area.x1, area.y1, area.width, 180.0),
        "west": Frontage(area.x0, area.y1, area.depth, 270.0),
    }[side]


@dataclass(frozen=True)
class Plan:
    """The plan of a city.

    :param streets: on the ground, the main street first
    :param bridges: streets that lead over the main street
    :param bounds: of the ground
    """

    streets: tuple[Street, ...]
    bridges: tuple[Street, ...]
    blocks: tuple[Block, ...]
    bounds: Rectangle

    @property
    def main(self) -> Street:
        return self.streets[0]

    def crossings_of(self, street: Street) -> list[tuple[float, Street]]:
        """Where along a street [m] it is crossed, and by which one; rising."""
        found = [
            (other.at, other)
            for other in self.streets
            if other.axis != street.axis
            and other.start <= street.at <= other.end
            and street.start <= other.at <= street.end
        ]
        return sorted(found, key=lambda pair: pair[0])

    def stretches(self, street: Street) -> list[tuple[float, float]]:
        """From and to along a street [m]: what lies clear of its crossings, and of the pedestrians' crossings there."""
        marks = [street.start + 2.0]
        for at, other in self.crossings_of(street):
            clear = other.kind.facade + 2.0 * ZEBRA_M
            marks += [at - clear, at + clear]
        marks.append(street.end - 2.0)
        pairs = zip(marks[::2], marks[1::2], strict=True)
        return [(first, last) for first, last in pairs if last - first >= 6.0]

    def zebras(self) -> list[tuple[Street, float]]:
        """The pedestrians' crossings: the street, and where along it their middle is [m]."""
        found = []
        for street in self.streets:
            for at, other in self.crossings_of(street):
                for sign in (-1.0, 1.0):
                    middle = at + sign * (other.kind.facade + 0.5 * ZEBRA_M)
                    if street.start < middle < street.end:
                        found.append((street, middle))
        return found


def draw_plan(rng: np.random.Generator, rules: Rules, blocks: int) -> Plan:
    """Draw a plan.

    :param blocks: columns of blocks along the main street
    """
    main_kind = rules.mains[int(rng.integers(len(rules.mains)))]
    kinds = [rules.sides[int(rng.integers(len(rules.sides)))] for _ in range(blocks + 3)]
    columns = [_to_half_metre(rng.uniform(*rules.column_m)) for _ in range(blocks)]
    count = int(rng.integers(rules.rows[0], rules.rows[1], endpoint=True))
    above = count - 1 if rng.random() < 0.5 else 1
    rows_up = [_to_half_metre(rng.uniform(*rules.row_m)) for _ in range(above)]
    rows_down = [_to_half_metre(rng.uniform(*rules.row_m)) for _ in range(count - above)]

    # Columns, from the west: block, cross street, block, ...; the middle of the city is x = 0.
    cross = kinds[: blocks - 1]
    length = sum(columns) + sum(2.0 * kind.facade for kind in cross)
    edges, centres, x = [], [], _to_half_metre(-0.5 * length)
    for index, width in enumerate(columns):
        edges.append((x, x + width))
        x += width
        if index < len(cross):
            centres.append(x + cross[index].facade)
            x += 2.0 * cross[index].facade
    west, east = edges[0][0] - REACH_M, x + REACH_M

    up, side_up = _rows(rows_up, main_kind.facade, kinds[blocks])
    down, side_down = _rows(rows_down, main_kind.facade, kinds[blocks + 1])
    north, south = up[-1][1] + REACH_M, -down[-1][1] - REACH_M
    main = Street("x", 0.0, west, east, main_kind)
    parallel = [Street("x", at, west, east, kinds[blocks]) for at in side_up]
    parallel += [Street("x", -at, west, east, kinds[blocks + 1]) for at in side_down]
    crossing_streets = []
    for centre, kind in zip(centres, cross, strict=True):
        ends_here = rng.random() < rules.tee
        goes_up = rng.random() < 0.5
        start = 0.0 if ends_here and goes_up else south
        end = 0.0 if ends_here and not goes_up else north
        crossing_streets.append(Street("y", centre, start, end, kind))

    plots = []
    for rows, sign in ((up, 1.0), (down, -1.0)):
        for number, (near, far) in enumerate(rows):
            y0, y1 = sorted((sign * near, sign * far))
            through = [street.start < 0.5 * (y0 + y1) < street.end for street in crossing_streets]
            for first, last in _merged(through):
                fronts = {"south" if sign > 0 else "north"} | ({"east"} if last < blocks - 1 else set())
                fronts |= {"west"} if first > 0 else set()
                fronts |= ({"north" if sign > 0 else "south"}) if number < len(rows) - 1 else set()
                area = Rectangle(edges[first][0], y0, edges[last][1], y1)
                plots.append(Block(area, drawn(rng, rules.uses), frozenset(fronts)))
    bounds = Rectangle(west, south, east, north)
    if rules.bridges:
        return Plan((main, *parallel), tuple(crossing_streets), tuple(plots), bounds)
    return Plan((main, *parallel, *crossing_streets), (), tuple(plots), bounds)


def _rows(depths: list[float], facade: float, kind: StreetKind) -> tuple[list[tuple[float, float]], list[float]]:
    """(near, far) of each row on one side of the main street, and the side streets between them [m]."""
    rows, between, y = [], [], facade
    for number, depth in enumerate(depths):
        if number:
            between.append(y + kind.facade)
            y += 2.0 * kind.facade
        rows.append((y, y + depth))
        y += depth
    return rows, between


def _merged(through: list[bool]) -> list[tuple[int, int]]:
    """(first, last) columns of the blocks of a row: where no street goes through, two columns are one block."""
    groups, first = [], 0
    for index, cut in enumerate(through):
        if cut:
            groups.append((first, index))
            first = index + 1
    return [*groups, (first, len(through))]


def _to_half_metre(value: float) -> float:
    return round(2.0 * value) / 2.0
