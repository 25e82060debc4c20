"""Radiation patterns of single elements, as power gain over direction in the radar frame.

Every pattern has ``power_gain(directions [..., 3]) -> [...]``; its ``kind`` names it in a radar's TOML file:

- ``isotropic``: the same gain everywhere;
- ``parabolic``: a main lobe parabolic in dB, the car radar's (:func:`car_radar_pattern`);
- ``patch``: a rectangular microstrip patch;
- ``tr38901``: the base-station element of 3GPP TR 38.901;
- ``table``: measured, from a CSV file.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from shared.radar.antenna.elements import (
    IsotropicPattern,
    ParabolicPattern,
    PatchPattern,
    Tr38901Pattern,
    car_radar_pattern,
)
from shared.radar.antenna.table import TablePattern, read_table

Pattern = Annotated[
    IsotropicPattern | ParabolicPattern | PatchPattern | Tr38901Pattern | TablePattern, Field(discriminator="kind")
]

__all__ = [
    "IsotropicPattern",
    "ParabolicPattern",
    "PatchPattern",
    "Pattern",
    "TablePattern",
    "Tr38901Pattern",
    "car_radar_pattern",
    "read_table",
]
