"""Blocks where people work, park or drive past: halls, depots, car parks, the verges of a motorway; and what only a
motorway has: guard rails and barriers along its edges and its median, gantries, bridges over it.
"""

from __future__ import annotations

import numpy as np

from datafactory.scenes.city.buildings import Building, Opening, bays, building
from datafactory.scenes.city.furniture import tank
from datafactory.scenes.city.plan import Block, Frontage, Plan, Rectangle, Street, frontage
from datafactory.scenes.city.rules import Rules, drawn
from datafactory.scenes.city.shapes import X_TO_Z_CYCLE, Surface, box, joined, prism
from datafactory.scenes.city.site import Site

FENCE_M = 5.0
BAY_M, BAY_DEPTH_M, AISLE_M = 2.5, 5.0, 6.0
"""Of a car park: width and length of a place, width of an aisle (EAR 05)."""
MODULE_M = 2.0 * BAY_DEPTH_M + AISLE_M


PIECE_M = 8.0
CLEARANCE_M = 5.2
DECK_M = 1.1
GIRDERS = 4


def works(site: Site, block: Block, rules: Rules) -> None:
    """A hall with gates, a fence, tanks and lorries before it."""
    rng = site.rng
    front = _street_side(block)
    inner_depth = block.area.depth - 16.0
    width, depth = rng.uniform(0.45, 0.75) * front.length, rng.uniform(0.45, 0.75) * inner_depth
    setback = rng.uniform(14.0, 18.0)
    start = rng.uniform(4.0, front.length - width - 4.0)
    hall = building(hall_style(rng, width, depth))
    site.place("Halls", "Hall", hall, front.place(start, setback), front.yaw_deg)
    for slot in range(int(width / 9.0)):
        if rng.random() < 0.4:
            place = front.place(start + 4.5 + 9.0 * slot, setback - 5.6, rules.kerb_m)
            site.place("Lorries", "Lorry", "Lorry", place, front.yaw_deg + 90.0 * rng.choice([-1.0, 1.0]), margin=0.3)
    _tanks(site, block, rules)
    _fences(site, block, rules)


def hall_style(rng: np.random.Generator, width: float, depth: float) -> Building:
    """A hall of steel or concrete: gates, a ribbon of windows above them."""
    opening = Opening(rng.uniform(3.2, 4.2), 4.3, 5.3, rng.uniform(5.5, 7.5))
    count = bays(width, opening)
    ground = tuple("gate" if rng.random() < 0.6 else "window" for _ in range(count))
    return Building(
        width, depth, 1, floor_m=rng.uniform(6.5, 10.5), wall=drawn(rng, (("metal", 0.5), ("concrete", 0.5))),
        frame="metal", roof="concrete", shape=drawn(rng, (("flat", 0.7), ("gable", 0.3))), opening=opening,
        glazed=frozenset({"front", "left", "right"}), ground=ground, base_m=0.14, cornice=True, pitch=0.25,
    )  # fmt: skip


def depot(site: Site, block: Block, rules: Rules) -> None:
    """Stacks of containers in rows, lorries between them, a small office, a fence."""
    rng, area = site.rng, block.area
    front = _street_side(block)
    office = Building(
        14.0, 9.0, 2, wall="concrete", frame="metal", roof="concrete", opening=Opening(1.8, 1.0, 2.4, 2.8),
        glazed=frozenset({"front", "left", "right"}), ground=("door",), cornice=True,
    )  # fmt: skip
    site.place("Halls", "Office", building(office), front.place(3.0, 8.0), front.yaw_deg)
    inner = area.inset(7.0)
    rows, columns = int(inner.depth / 12.0), int(inner.width / 6.6)
    for row in range(rows):
        for column in range(columns):
            x, y = inner.x0 + 3.3 + 6.6 * column, inner.y0 + 4.0 + 12.0 * row
            if rng.random() < 0.5:
                for level in range(int(rng.integers(1, 3, endpoint=True))):
                    z = rules.kerb_m + 2.59 * level
                    if not site.place("Containers", "Container", "Container", (x, y, z), 0.0):
                        break
            elif rng.random() < 0.12:
                site.place("Lorries", "Lorry", "Lorry", (x, y + 5.0, rules.kerb_m), 180.0 * rng.integers(2), margin=0.3)
    _fences(site, block, rules)


def _street_side(block: Block) -> Frontage:
    """The side along the main street, or the nearest street to it."""
    return frontage(block.area, sorted(block.fronts & {"south", "north"})[0])


def _tanks(site: Site, block: Block, rules: Rules) -> None:
    rng, inner = site.rng, block.area.inset(8.0)
    surface = tank(round(rng.uniform(1.8, 3.5), 1), round(rng.uniform(5.0, 9.0), 1))
    for _ in range(int(rng.integers(0, 4))):
        x, y = rng.uniform(inner.x0, inner.x1), rng.uniform(inner.y0, inner.y1)
        site.place("Tanks", "Tank", surface, (x, y, rules.kerb_m), margin=1.0)


def _fences(site: Site, block: Block, rules: Rules) -> None:
    """A fence along the streets, with an open gate now and then."""
    for side in sorted(block.fronts):
        line = frontage(block.area, side)
        for index in range(int((line.length - 1.0) / FENCE_M)):
            if site.rng.random() < 0.85:
                place = line.place(0.5 + FENCE_M * index, 0.4, rules.kerb_m)
                site.place("Fences", "Fence", "Fence", place, line.yaw_deg)


def islands(block: Block) -> list[Rectangle]:
    """The kerbed islands at the ends of a car park's double rows."""
    found = []
    for middle in _double_rows(block.area):
        for x in (block.area.x0 + 6.5, block.area.x1 - 8.5):
            found.append(Rectangle(x, middle - BAY_DEPTH_M + 0.4, x + 2.0, middle + BAY_DEPTH_M - 0.4))
    return found


def _double_rows(area: Rectangle) -> list[float]:
    """y of the middle of each double row of a car park; aisles lie between them."""
    usable = area.depth - 10.0
    count = max(1, int(usable / MODULE_M))
    first = 0.5 * (area.y0 + area.y1) - 0.5 * (count - 1) * MODULE_M
    return [first + MODULE_M * index for index in range(count)]


def parking(site: Site, block: Block, rules: Rules) -> None:
    """Rows of cars on both sides of aisles, lamps and trees on islands, shelters for trolleys."""
    rng, area, z = site.rng, block.area, rules.kerb_m
    for island in islands(block):
        x, y = 0.5 * (island.x0 + island.x1), 0.5 * (island.y0 + island.y1)
        if rng.random() < rules.trees:
            for aside in (-2.6, 2.6):
                model = f"Tree_{rng.integers(3)}"
                site.place("Trees", "Tree", model, (x, y + aside, 2.0 * z), float(rng.integers(0, 360)))
        else:
            site.place("Lamps", "Lamp", "Lamp", (x, y, 2.0 * z), 180.0 * rng.integers(2))
    for middle in _double_rows(area):
        taken = rng.uniform(0.2, 0.9)
        for aside in (-0.5 * BAY_DEPTH_M, 0.5 * BAY_DEPTH_M):
            for slot in range(int((area.width - 20.0) / BAY_M)):
                x = area.x0 + 10.0 + (slot + 0.5) * BAY_M
                if rng.random() >= taken:
                    continue
                model = drawn(rng, (("Saloon", 0.42), ("Hatchback", 0.46), ("Van", 0.12)))
                skew = float(rng.integers(-2, 2, endpoint=True))
                heading = 90.0 * float(rng.choice([-1.0, 1.0])) + skew
                place = (x + rng.uniform(-0.15, 0.15), middle + aside + rng.uniform(-0.2, 0.2), z)
                site.place("Cars", "Car", model, place, heading, margin=0.05)
    for _ in range(int(rng.integers(1, 4))):
        x = rng.uniform(area.x0 + 3.0, area.x1 - 3.0)
        site.place("Shelters", "Shelter", "Shelter", (x, area.y0 + 2.2, z), 0.0, margin=0.5)
    for side in sorted(block.fronts):
        line = frontage(area, side)
        for index in range(int(line.length / 4.0)):
            if rng.random() < 0.5:
                site.place("Bollards", "Bollard", "Bollard", line.place(2.0 + 4.0 * index, 0.4, z))


def verge(site: Site, block: Block, rules: Rules) -> None:
    """Beside a motorway: a noise barrier along some of it, trees and bushes behind."""
    rng, area = site.rng, block.area
    line = _street_side(block)
    walled = rng.random() < 0.6
    first, last = (
        (2.0, line.length - 2.0) if rng.random() < 0.5 else (rng.uniform(0.1, 0.4) * line.length, line.length - 2.0)
    )
    if walled:
        model = f"NoiseWall_{rng.integers(2)}"
        for index in range(int((last - first) / 4.0)):
            site.place("NoiseWalls", "NoiseWall", model, line.place(first + 4.0 * index, 1.0), line.yaw_deg)
    inner = area.inset(4.0)
    for _ in range(int(inner.width * inner.depth / 130.0)):
        x, y = rng.uniform(inner.x0, inner.x1), rng.uniform(inner.y0, inner.y1)
        kind = drawn(rng, (("Tree", 0.6), ("Conifer", 0.4)))
        model = f"{kind}_{rng.integers(2 if kind == 'Conifer' else 3)}"
        site.place("Trees", kind, model, (x, y, rules.kerb_m), float(rng.integers(0, 360)), margin=0.2)


def equip(site: Site, plan: Plan) -> None:
    """Rails, median, gantries and bridges of the main street."""
    main, kind = plan.main, plan.main.kind
    for street in plan.bridges:
        site.place("Bridges", "Bridge", _bridge(street, main), (street.at, 0.0, 0.0))
    median = "Barrier" if site.rng.random() < 0.5 else "GuardRail"
    for index in range(int((main.end - main.start) / PIECE_M)):
        x = main.start + PIECE_M * index
        # Rails face -y of their own: the traffic.
        site.place("Rails", "GuardRail", "GuardRail", (x, kind.kerb + 0.6, 0.0))
        site.place("Rails", "GuardRail", "GuardRail", (x + PIECE_M, -kind.kerb - 0.6, 0.0), 180.0)
        if median == "Barrier":
            site.place("Rails", "Barrier", "Barrier", (x, 0.0, 0.0))
        else:
            site.place("Rails", "GuardRail", "GuardRail", (x + PIECE_M, kind.median_m - 0.7, 0.0), 180.0)
            site.place("Rails", "GuardRail", "GuardRail", (x, -kind.median_m + 0.7, 0.0))
    for x in np.arange(main.start + site.rng.uniform(30.0, 90.0), main.end - 10.0, site.rng.uniform(110.0, 180.0)):
        site.place("Gantries", "Gantry", "Gantry", (round(float(x), 1), 0.0, 0.0), 180.0 * float(site.rng.integers(2)))
    for x in np.arange(main.start + 20.0, main.end, 50.0):
        for side in (1.0, -1.0):
            site.place("Posts", "Bollard", "Bollard", (round(float(x), 1), side * (kind.kerb + 1.4), 0.0))


def _bridge(street: Street, main: Street) -> Surface:
    """A road bridge along y over a street along x: abutments, piers beside the median, girders, deck and parapets."""
    half, reach = street.kind.facade, main.kind.facade + 2.0
    top = CLEARANCE_M + DECK_M
    deck = box((-half, -reach - 6.0, top - 0.3), (half, reach + 6.0, top), "concrete")
    places = np.linspace(-half + 0.6, half - 0.6, GIRDERS)
    girders = [box((x - 0.25, -reach, CLEARANCE_M), (x + 0.25, reach, top - 0.3), "concrete") for x in places]
    parapets = [
        box((x - 0.15, -reach - 6.0, top), (x + 0.15, reach + 6.0, top + 1.0), "concrete")
        for x in (-half + 0.15, half - 0.15)
    ]
    abutments = []
    for sign in (1.0, -1.0):
        near, far = sign * reach, sign * (reach + 6.0)
        abutments.append(box((-half, min(near, far), 0.0), (half, max(near, far), top - 0.3), "concrete"))
        # The embankment behind: a ramp down to the ground.
        ramp = [(far, 0.0), (far + sign * 14.0, 0.0), (far, top)]
        ramp = ramp if sign > 0.0 else ramp[::-1]
        abutments.append(prism(ramp, -half, half, "vegetation").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE))
    return joined([deck, *girders, *parapets, *abutments])
