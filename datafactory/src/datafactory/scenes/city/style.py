"""The styles of a city, by name: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

from enum import StrEnum

MOST_BLOCKS = 20


class Style(StrEnum):
    """What a city is like."""

    OLD_TOWN = "old-town"
    SUBURB = "suburb"
    MOTORWAY = "motorway"
    INDUSTRIAL = "industrial"
    CAR_PARK = "car-park"
