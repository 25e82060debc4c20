"""How a road is divided across, from its middle outwards: lanes, a strip to park in, kerb, pavement.

Traffic keeps to the right. With y to the left of a road's heading, those who drive along it keep to y < 0. Widths are
those of a street in a town (RASt 06): lanes of 3.5 m, 3 m where there is one; a strip of 2.1 m to park in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.scenes.traffic.stretches import WIDTHS_M

FURNITURE_M = 0.45
"""Poles and signs stand so far behind the kerb."""
FIRST_ROW_M = 1.1
"""The first row of walkers."""
ROW_M = 0.7
WALL_M = 0.35
"""Nobody walks nearer to what bounds the pavement."""
PAVEMENT_M = 4.0


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
