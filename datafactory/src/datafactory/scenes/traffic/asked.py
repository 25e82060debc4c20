"""What ``--populate`` asks for."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

from shared.physics.errors import InputError, meant

LARGEST_COUNT = 2000


@dataclass(frozen=True)
class Asked:
    """How much of what a scene is to be populated with.

    :param cars, trucks, buses: that drive
    :param cyclists, pedestrians: that ride and walk
    :param poles: lamps, traffic lights and bollards; :param signs: of traffic
    :param bins, benches: on the pavement
    :param parked: share of the kerbs along the populated roads that parked cars take, 0 to 1
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

    @property
    def counts(self) -> dict[str, int]:
        """Numbers by kind, without those that were not asked for."""
        return {kind: count for kind, count in asdict(self).items() if kind != "parked" and count}

    @property
    def text(self) -> str:
        """As ``--populate`` takes it."""
        return ",".join(f"{kind}={value:g}" for kind, value in asdict(self).items() if value)


KINDS = tuple(item.name for item in fields(Asked))


def parse_populate(text: str) -> Asked:
    """``"cars=20,parked=0.6"`` as a value.

    :raises InputError: an entry without a number, an unknown or doubled kind, a number out of its bounds
    """
    found: dict[str, float] = {}
    for entry in text.split(","):
        kind, equals, value = (part.strip() for part in entry.partition("="))
        if kind not in KINDS:
            raise InputError("--populate", f"unknown kind {kind!r}", f"one of {', '.join(KINDS)}{meant(kind, KINDS)}")
        if kind in found:
            raise InputError("--populate", f"{kind} is given twice", "each kind once")
        if not equals:
            raise InputError("--populate", f"{kind} without a number", f"{kind}=NUMBER")
        found[kind] = _share(value) if kind == "parked" else _count(kind, value)
    return Asked(**found)  # type: ignore[arg-type]


def _count(kind: str, value: str) -> int:
    if not (value.isascii() and value.isdigit() and int(value) <= LARGEST_COUNT):
        raise InputError("--populate", f"{kind}={value}", f"a whole number from 0 to {LARGEST_COUNT}")
    return int(value)


def _share(value: str) -> float:
    try:
        share = float(value)
    except ValueError:
        share = -1.0
    if not 0.0 <= share <= 1.0:
        raise InputError("--populate", f"parked={value}", "a share of the kerb from 0 to 1")
    return share
