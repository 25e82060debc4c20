"""What each style of city is made of: widths, chances and how they are drawn. The builders beside this module use them.

Widths of streets follow the German guidelines RASt 06 (urban roads) and RAA (motorways), rounded to 0.25 m. This module
imports nothing that computes, so that ``--help`` may name the styles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

MOST_BLOCKS = 20


class Style(StrEnum):
    """What a city is like."""

    OLD_TOWN = "old-town"
    SUBURB = "suburb"
    MOTORWAY = "motorway"
    INDUSTRIAL = "industrial"
    CAR_PARK = "car-park"


Span = tuple[float, float]
"""From and to, drawn uniformly."""


@dataclass(frozen=True)
class StreetKind:
    """The cross section of a street, from its centre line outwards.

    :param lanes: in each direction
    :param lane_m: width of each
    :param median_m: half the strip between the directions
    :param parking_m: width of the parking strip, or hard shoulder; 0 for none
    :param pavement_m: from the kerb to where buildings may begin
    """

    lanes: int
    lane_m: float
    median_m: float
    parking_m: float
    pavement_m: float

    @property
    def kerb(self) -> float:
        """From the centre line to the kerb [m]."""
        return self.median_m + self.lanes * self.lane_m + self.parking_m

    @property
    def facade(self) -> float:
        """From the centre line to where buildings may begin [m]."""
        return self.kerb + self.pavement_m


@dataclass(frozen=True)
class Rules:
    """What a style draws from.

    :param mains, sides: kinds of the main street and of all others; one of each is drawn
    :param rows: least and largest number of rows of blocks, the main street between the first two
    :param column_m, row_m: length of a block along the main street, and its depth
    :param tee: chance that a cross street ends at the main street
    :param uses: what blocks are used for, with weights
    :param kerb_m: height of the kerbs
    :param heavy: share of lorries and buses among vehicles
    :param parked: share of the parking strip's places that are taken
    :param trees, lamps_m, lamp_height_m: chance of a tree at a slot of the kerb, spacing and height of lamps
    :param walked: whether people walk here: bus stops and litter bins
    :param signals: whether crossings have traffic lights
    :param bridges: whether cross streets lead over the main street
    """

    mains: tuple[StreetKind, ...]
    sides: tuple[StreetKind, ...]
    rows: tuple[int, int]
    column_m: Span
    row_m: Span
    tee: float
    uses: tuple[tuple[str, float], ...]
    kerb_m: float = 0.12
    heavy: float = 0.08
    parked: float = 0.6
    trees: float = 0.5
    lamps_m: float = 30.0
    lamp_height_m: float = 7.0
    walked: bool = True
    signals: bool = True
    bridges: bool = False


# fmt: off
RULES = {
    Style.OLD_TOWN: Rules(
        mains=(StreetKind(1, 3.5, 0.0, 2.0, 3.0), StreetKind(1, 3.25, 0.0, 2.0, 4.0),
               StreetKind(2, 3.25, 0.0, 0.0, 4.0)),
        sides=(StreetKind(1, 2.75, 0.0, 0.0, 2.0), StreetKind(1, 3.0, 0.0, 2.0, 2.5)),
        rows=(2, 3), column_m=(52.0, 84.0), row_m=(34.0, 52.0), tee=0.35,
        uses=(("houses", 0.8), ("square", 0.12), ("park", 0.08)),
    ),
    Style.SUBURB: Rules(
        mains=(StreetKind(1, 3.25, 0.0, 2.0, 3.5), StreetKind(1, 3.25, 0.0, 0.0, 4.5)),
        sides=(StreetKind(1, 2.75, 0.0, 0.0, 2.0), StreetKind(1, 2.75, 0.0, 2.0, 1.75)),
        rows=(2, 3), column_m=(60.0, 95.0), row_m=(46.0, 60.0), tee=0.4,
        uses=(("gardens", 0.85), ("park", 0.15)),
        heavy=0.05, parked=0.3, trees=0.6, lamps_m=34.0, lamp_height_m=5.0, signals=False,
    ),
    Style.MOTORWAY: Rules(
        mains=(StreetKind(2, 3.75, 2.0, 2.5, 3.0), StreetKind(3, 3.75, 2.0, 2.5, 3.0),
               StreetKind(3, 3.5, 1.75, 0.0, 2.5)),
        sides=(StreetKind(1, 3.5, 0.0, 0.0, 1.5),),
        rows=(2, 2), column_m=(150.0, 190.0), row_m=(36.0, 46.0), tee=0.0,
        uses=(("verge", 1.0),),
        kerb_m=0.0, heavy=0.25, parked=0.0, trees=0.0, lamps_m=0.0, walked=False, signals=False, bridges=True,
    ),
    Style.INDUSTRIAL: Rules(
        mains=(StreetKind(1, 3.75, 0.0, 0.0, 2.5), StreetKind(1, 3.75, 0.0, 2.5, 2.5),
               StreetKind(2, 3.5, 0.0, 0.0, 2.5)),
        sides=(StreetKind(1, 3.5, 0.0, 2.5, 2.0), StreetKind(1, 3.5, 0.0, 0.0, 2.0)),
        rows=(2, 2), column_m=(85.0, 125.0), row_m=(58.0, 76.0), tee=0.4,
        uses=(("works", 0.55), ("depot", 0.35), ("park", 0.1)),
        heavy=0.45, parked=0.35, trees=0.1, lamps_m=40.0, lamp_height_m=9.0,
    ),
    Style.CAR_PARK: Rules(
        mains=(StreetKind(1, 3.5, 0.0, 0.0, 3.0), StreetKind(2, 3.25, 0.0, 0.0, 3.0)),
        sides=(StreetKind(1, 3.0, 0.0, 0.0, 2.0),),
        rows=(2, 2), column_m=(66.0, 100.0), row_m=(50.0, 74.0), tee=0.5,
        uses=(("parking", 0.8), ("works", 0.2)),
        heavy=0.06, parked=0.0, trees=0.4, lamp_height_m=6.0,
    ),
}
# fmt: on


def drawn(rng: np.random.Generator, weights: Sequence[tuple[str, float]]) -> str:
    """One of the names, by weight."""
    at = rng.random() * sum(weight for _, weight in weights)
    for name, weight in weights:
        at -= weight
        if at < 0.0:
            return name
    return weights[-1][0]
