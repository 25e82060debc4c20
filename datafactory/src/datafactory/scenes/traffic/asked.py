"""What ``--populate`` asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from shared.physics.errors import InputError, meant

LARGEST_COUNT = 2000
"""Of a kind, however it was asked for."""
LARGEST_DENSITY = 100.0
"""One a metre: more than has room of any kind."""
PER_100_M = "/100m"
"""Behind the number of a density."""


@dataclass(frozen=True)
class Asked:
    """How much of what a scene is to be populated with.

    :param cars, trucks, buses: that drive
    :param cyclists, pedestrians: that ride and walk
    :param poles: lamps, traffic lights and bollards; :param signs: of traffic
    :param bins, benches: on the pavement
    :param parked: share of the kerbs along the populated roads that parked cars take, 0 to 1
    :param densities: (kind, number a hundred metres of populated road), instead of a number
    """

    cars: int = 0
    trucks: int = 0
    buses: int = 0
    cyclists: int = 0
    pedestrians: int = 0
    poles: int = 0
    signs: int = 0
    bins: int = 0
    benches: int = 0
    parked: float = 0.0
    densities: tuple[tuple[str, float], ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """Numbers by kind, without those that were not asked for."""
        return {kind: getattr(self, kind) for kind in COUNTED if getattr(self, kind)}

    def along(self, road_m: float) -> Asked:
        """With numbers in place of densities, for so much road [m]."""
        numbers = {kind: min(round(density * road_m / 100.0), LARGEST_COUNT) for kind, density in self.densities}
        return replace(self, densities=(), **numbers)

    @property
    def text(self) -> str:
        """As ``--populate`` takes it."""
        said = {kind: f"{getattr(self, kind):g}" for kind in KINDS if getattr(self, kind)}
        said |= {kind: f"{density:g}{PER_100_M}" for kind, density in self.densities}
        return ",".join(f"{kind}={said[kind]}" for kind in KINDS if kind in said)


KINDS = tuple(item.name for item in fields(Asked) if item.name != "densities")
COUNTED = tuple(kind for kind in KINDS if kind != "parked")


def parse_populate(text: str) -> Asked:
    """``"cars=20,parked=0.6"`` or ``"cars=4/100m"`` as a value.

    :raises InputError: an entry without a number, an unknown or doubled kind, a number out of its bounds
    """
    found: dict[str, float] = {}
    densities: dict[str, float] = {}
    for entry in text.split(","):
        kind, equals, value = (part.strip() for part in entry.partition("="))
        if kind not in KINDS:
            raise InputError("--populate", f"unknown kind {kind!r}", f"one of {', '.join(KINDS)}{meant(kind, KINDS)}")
        if kind in found or kind in densities:
            raise InputError("--populate", f"{kind} is given twice", "each kind once")
        if not equals:
            raise InputError("--populate", f"{kind} without a number", f"{kind}=NUMBER")
        if kind in COUNTED and value.endswith(PER_100_M):
            densities[kind] = _density(kind, value)
        else:
            found[kind] = _share(value) if kind == "parked" else _count(kind, value)
    return Asked(**found, densities=tuple(densities.items()))  # type: ignore[arg-type]


def _count(kind: str, value: str) -> int:
    if not (value.isascii() and value.isdigit() and int(value) <= LARGEST_COUNT):
        raise InputError("--populate", f"{kind}={value}", f"a whole number from 0 to {LARGEST_COUNT}")
    return int(value)


def _density(kind: str, value: str) -> float:
    try:
        density = float(value.removesuffix(PER_100_M))
    except ValueError:
        density = math.nan
    if not 0.0 <= density <= LARGEST_DENSITY:
        expected = f"from 0 to {LARGEST_DENSITY:g} a hundred metres of road, as {kind}=4{PER_100_M}"
        raise InputError("--populate", f"{kind}={value}", expected)
    return density


def _share(value: str) -> float:
    try:
        share = float(value)
    except ValueError:
        share = -1.0
    if not 0.0 <= share <= 1.0:
        raise InputError("--populate", f"parked={value}", "a share of the kerb from 0 to 1")
    return share
