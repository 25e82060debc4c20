"""What stands along the kerbs of a city: lamps, trees, signs, signals, bus stops, parked vehicles, covers in the road.

All of it lies on the stretches of a street that are clear of its crossings (:meth:`Plan.stretches`). Coordinates are
those of a street: along it, and to the left of its axis.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from datafactory.scenes.city.plan import ZEBRA_M, Plan, Street
from datafactory.scenes.city.rules import Rules, drawn
from datafactory.scenes.city.site import Site

SLOT_M = 8.5
"""Between the places of trees, lamps and signs along a kerb."""
FROM_KERB_M = 0.6
PLACE_M = 6.2
"""Length of a parking place along a kerb."""
SIDES = (1.0, -1.0)
TREE_NEEDS_M = 3.4
"""Width of pavement from which on there are trees: a crown reaches 1.6 m, a balcony 1.1 m."""
SHELTER_NEEDS_M = 3.9
"""Width of pavement that leaves 1.5 m behind a shelter for those who walk past."""


def furnish(site: Site, plan: Plan, rules: Rules) -> None:
    """Everything along all streets, the main street first."""
    for street in plan.streets:
        for first, last in plan.stretches(street):
            for side in SIDES:
                stop = _bus_stop(site, street, first, last, side, rules) if street is plan.main else None
                _kerb_line(site, street, first, last, side, rules)
                _parked(site, street, first, last, side, rules, stop)
        _covers(site, street, rules)
    _corners(site, plan, rules)


def _heading(street: Street, side: float) -> float:
    """Of traffic on this side of the street: to the right of the axis it goes along the axis."""
    return street.yaw_deg + (180.0 if side > 0.0 else 0.0)


@dataclass(frozen=True)
class Piece:
    """What stands at a place beside a kerb.

    :param group, kind, model: as :meth:`Site.place` takes them
    """

    group: str
    kind: str
    model: str
    yaw_deg: float


def pieces_along(
    rng: np.random.Generator,
    rules: Rules,
    slots: Iterable[tuple[float, float]],
    trees: bool = True,
    rails: bool = False,
) -> Iterator[tuple[int, Piece]]:
    """Lamps, trees, signs, litter bins and rails beside a kerb, each with the number of its slot.

    :param slots: how far along the kerb each is [m], and the heading of the traffic beside it [degree]
    :param trees, rails: whether there is room for them
    """
    lamp = rng.uniform(2.0, 12.0) if rules.lamps_m else np.inf
    for number, (along, heading) in enumerate(slots):
        if along >= lamp:
            # The arm, along -y of the lamp, reaches over the road.
            yield number, Piece("Lamps", "Lamp", "Lamp", (heading + 180.0) % 360.0)
            lamp += rules.lamps_m
            continue
        what = drawn(rng, (("tree", rules.trees), ("sign", 0.12), ("bin", 0.08), ("rail", 0.05), ("none", 0.25)))
        if what == "tree" and trees:
            yield number, Piece("Trees", "Tree", f"Tree_{rng.integers(3)}", float(rng.integers(0, 360)))
        elif what == "sign":
            # A sign faces -x of its own: against the traffic that passes it.
            model = f"Sign_{drawn(rng, (('round', 0.4), ('triangle', 0.3), ('panel', 0.3)))}"
            yield number, Piece("Signs", "Sign", model, heading)
        elif what == "bin":
            yield number, Piece("Bins", "Bin", "Bin", 0.0)
        elif what == "rail" and rails:
            yield number, Piece("Rails", "Rail", "PedestrianRail", heading % 180.0)


def _kerb_line(site: Site, street: Street, first: float, last: float, side: float, rules: Rules) -> None:
    kind, heading = street.kind, _heading(street, side)
    places = [3.0 + SLOT_M * slot for slot in range(int((last - first) / SLOT_M))]
    pieces = pieces_along(
        site.rng, rules, [(place, heading) for place in places],
        trees=kind.pavement_m >= TREE_NEEDS_M, rails=not kind.parking_m,
    )  # fmt: skip
    for number, item in pieces:
        aside, margin = (0.3, 0.1) if item.kind == "Rail" else (FROM_KERB_M, 0.0)
        place = street.point(first + places[number], side * (kind.kerb + aside), rules.kerb_m)
        site.place(item.group, item.kind, item.model, place, item.yaw_deg, margin)


def _bus_stop(
    site: Site, street: Street, first: float, last: float, side: float, rules: Rules
) -> tuple[float, float] | None:
    """A flag at the kerb, a shelter on a wide pavement, now and then a bus in a wide strip; what it takes up."""
    rng, kind = site.rng, street.kind
    if not rules.walked or last - first < 40.0 or rng.random() < 0.45:
        return None
    middle = rng.uniform(first + 16.0, last - 16.0)
    if kind.pavement_m >= SHELTER_NEEDS_M:
        shelter = street.point(middle, side * (kind.kerb + 0.9), rules.kerb_m)
        # The shelter opens along -y of its own, towards the road.
        site.place("BusStops", "Shelter", "Shelter", shelter, street.yaw_deg + (0.0 if side > 0.0 else 180.0))
    ahead = middle + (-4.0 if side > 0.0 else 4.0)
    flag = street.point(ahead, side * (kind.kerb + 0.45), rules.kerb_m)
    site.place("BusStops", "Sign", "Sign_panel", flag, _heading(street, side))
    if kind.parking_m >= 2.5 and rng.random() < 0.5:
        place = street.point(middle, side * (kind.kerb - 1.4), 0.0)
        site.place("Buses", "Bus", "Bus", place, _heading(street, side))
    return middle - 9.0, middle + 9.0


def _parked(
    site: Site, street: Street, first: float, last: float, side: float, rules: Rules, stop: tuple[float, float] | None
) -> None:
    """A row of parked vehicles in the strip beside the kerb."""
    rng, kind = site.rng, street.kind
    if kind.parking_m < 1.9:
        return
    along = first + 3.5 + rng.uniform(0.0, 2.0)
    share = rules.parked * rng.uniform(0.6, 1.4)
    while along < last - 3.0:
        lorry = kind.parking_m >= 2.5 and rng.random() < 0.4 * rules.heavy
        length = 11.0 if lorry else PLACE_M
        at, taken = along + 0.5 * length - 3.1, rng.random() < share
        along += length
        model = "Lorry" if lorry else drawn(rng, (("Saloon", 0.42), ("Hatchback", 0.42), ("Van", 0.16)))
        aside = kind.kerb - (1.4 if lorry else 1.04) + rng.uniform(-0.07, 0.07)
        skew = 0.0 if lorry else float(rng.integers(-2, 2, endpoint=True))
        if not taken or along > last or (stop is not None and stop[0] < at < stop[1]):
            continue
        group, name = ("Lorries", "Lorry") if lorry else ("Cars", "Car")
        site.place(group, name, model, street.point(at, side * aside, 0.0), _heading(street, side) + skew)


def _covers(site: Site, street: Street, rules: Rules) -> None:
    """Manhole covers in the lanes."""
    if rules.kerb_m == 0.0:
        return
    along = street.start + site.rng.uniform(8.0, 30.0)
    while along < street.end - 3.0:
        aside = site.rng.uniform(-0.8, 0.8) * (street.kind.kerb - street.kind.parking_m - 0.6)
        site.add("Covers", "Manhole", "Manhole", street.point(along, aside, 0.0))
        along += site.rng.uniform(22.0, 48.0)


def _corners(site: Site, plan: Plan, rules: Rules) -> None:
    """Bollards beside the pedestrians' crossings, and the signals or signs of the traffic that comes there."""
    for street, middle in plan.zebras():
        crossings = plan.crossings_of(street)
        at, _ = min(crossings, key=lambda pair: abs(pair[0] - middle))
        outwards = 1.0 if middle > at else -1.0
        for side in SIDES:
            along = middle + outwards * (0.5 * ZEBRA_M + 0.4)
            aside = side * (street.kind.kerb + 0.4)
            # Traffic that comes towards the crossing keeps to its right: to the left of the way outwards.
            if side == outwards:
                model = "Signal" if rules.signals else "Sign_triangle"
                kind = "Signal" if rules.signals else "Sign"
                site.place("Signals", kind, model, street.point(along, aside, rules.kerb_m), _heading(street, side))
            elif site.rng.random() < 0.5:
                site.place("Bollards", "Bollard", "Bollard", street.point(along, aside, rules.kerb_m))
