"""Blocks where people live: rows of town houses, houses in gardens, squares and parks."""

from __future__ import annotations

import numpy as np

from datafactory.scenes.city.buildings import Building, Opening, bays, building
from datafactory.scenes.city.plan import Block, Frontage, Rectangle, frontage
from datafactory.scenes.city.rules import Rules, drawn
from datafactory.scenes.city.shapes import box
from datafactory.scenes.city.site import Site

WALLS = (("brick", 0.35), ("plasterboard", 0.35), ("concrete", 0.2), ("marble", 0.1))
SLACK_M = 0.02
"""Between neighbouring houses: their walls do not coincide."""


def houses(site: Site, block: Block, rules: Rules) -> None:
    """Rows of town houses on all sides of the block, around a court; those towards no street have no windows."""
    rng = site.rng
    depth = min(rng.uniform(9.5, 12.5), 0.5 * block.area.depth - 3.0)
    floors = int(rng.integers(3, 5, endpoint=True))
    for side in ("north", "south"):
        _row(site, frontage(block.area, side), depth, floors, side in block.fronts, corners=True)
    for side in ("east", "west"):
        # Between the rows of the two other sides.
        whole = frontage(block.area, side)
        length = whole.length - 2.0 * (depth + 3.0)
        if length >= 9.0:
            part = Frontage(*whole.place(depth + 3.0, 0.0)[:2], length, whole.yaw_deg)
            _row(site, part, min(depth, 0.5 * block.area.width - 4.0), floors, side in block.fronts, corners=False)
    court = block.area.inset(depth + 4.5)
    _trees(site, court, rules, count=int(court.width * max(court.depth, 0.0) / 150.0))


def _row(site: Site, front: Frontage, depth: float, floors: int, on_street: bool, corners: bool) -> None:
    """A row of houses, in runs of one setback with gaps between the runs.

    :param on_street: whether its fronts have windows
    :param corners: whether the ends of the row are corners of the block, and have windows like the fronts
    """
    rng = site.rng
    at, setback, gap_before = 0.0, 0.0, corners
    while front.length - at >= 8.0:
        width = min(rng.uniform(9.0, 16.5), front.length - at)
        if front.length - at - width < 8.0:
            width = front.length - at if front.length - at < 19.0 else width
        last = front.length - at - width < 8.0
        ends_run = not last and rng.random() < 0.25
        glazed = {"front"}
        glazed |= {"left"} if gap_before else set()
        glazed |= {"right"} if ends_run or (last and corners) else set()
        style = town_house(rng, width - SLACK_M, depth - setback, floors, frozenset(glazed if on_street else ()))
        site.place("Houses", "House", building(style), front.place(at, setback), front.yaw_deg)
        at += width
        gap_before = ends_run
        if ends_run:
            at += rng.uniform(2.5, 5.0)
            setback = rng.uniform(0.0, 2.0)


def town_house(rng: np.random.Generator, width: float, depth: float, floors: int, glazed: frozenset[str]) -> Building:
    """A house of its own style: storeys about ``floors``, openings, roof, shop, relief."""
    floors = max(2, floors + int(rng.integers(-1, 1, endpoint=True)))
    opening = Opening(rng.uniform(1.0, 1.5), rng.uniform(0.8, 1.0), rng.uniform(2.3, 2.5), rng.uniform(2.5, 3.1))
    count = bays(width, opening)
    ground = ["shop" if rng.random() < 0.35 else "window"] * count
    ground[int(rng.integers(count))] = "door"
    relief = drawn(rng, (("bands", 0.4), ("balconies", 0.3), ("plain", 0.3)))
    balconies = []
    if relief == "balconies":
        columns = [bay for bay in range(count) if width / count > 2.2 and bay % 2 == int(rng.integers(2))]
        balconies = [(floor, bay) for floor in range(1, floors) for bay in columns]
    return Building(
        width, depth, floors,
        wall=drawn(rng, WALLS), frame=drawn(rng, (("wood", 0.6), ("metal", 0.4))),
        roof="brick", shape=drawn(rng, (("gable", 0.5), ("hip", 0.15), ("flat", 0.35))),
        opening=opening, glazed=glazed, ground=tuple(ground),
        bands=relief == "bands", cornice=rng.random() < 0.6, balconies=tuple(balconies) if "front" in glazed else (),
        railing=drawn(rng, (("metal", 0.6), ("glass", 0.2), ("concrete", 0.2))),
    )  # fmt: skip


def gardens(site: Site, block: Block, rules: Rules) -> None:
    """Houses in gardens: each on a plot of its own, with a drive, a hedge or fence, trees."""
    rng = site.rng
    for side in sorted(block.fronts & {"south", "north"}):
        front = frontage(block.area, side)
        depth = 0.5 * block.area.depth if {"south", "north"} <= block.fronts else min(30.0, block.area.depth)
        at = 0.0
        while front.length - at >= 15.0:
            plot = rng.uniform(15.0, 21.0)
            plot = front.length - at if front.length - at - plot < 15.0 and front.length - at < 27.0 else plot
            _plot(site, front, at, plot, depth, rules)
            at += plot
    _trees(site, block.area.inset(3.0), rules, count=int(block.area.width * block.area.depth / 450.0))


def _plot(site: Site, front: Frontage, at: float, width: float, depth: float, rules: Rules) -> None:
    rng, z = site.rng, rules.kerb_m
    house_width, house_depth = rng.uniform(8.5, 11.5), rng.uniform(8.0, min(10.0, depth - 10.0))
    setback, drive_left = rng.uniform(4.0, 7.5), rng.random() < 0.5
    drive = at + 2.2 if drive_left else at + width - 2.2
    start = at + 4.6 if drive_left else at + width - 4.6 - house_width
    style = garden_house(rng, house_width, house_depth)
    site.place("Houses", "House", building(style), front.place(start, setback), front.yaw_deg)
    if rng.random() < 0.6:
        garage = Building(
            3.2, 6.0, 1, floor_m=2.3, wall=style.wall, roof="concrete", base_m=0.13,
            opening=Opening(2.5, 2.1, 2.2, 3.2), ground=("gate",),
        )  # fmt: skip
        site.place("Houses", "Garage", building(garage), front.place(drive - 1.6, setback + 2.0), front.yaw_deg)
    if rng.random() < rules.parked + 0.2:
        model = drawn(rng, (("Saloon", 0.4), ("Hatchback", 0.45), ("Van", 0.15)))
        site.place("Cars", "Car", model, front.place(drive, setback - 1.2, z), front.yaw_deg + 90.0, margin=0.1)
    edge = drawn(rng, (("hedge", 0.5), ("fence", 0.25), ("open", 0.25)))
    # Along the pavement, open at the drive and at the path to the door.
    first, last = (drive + 2.0, at + width - 0.2) if drive_left else (at + 0.2, drive - 2.0)
    middle = 0.5 * (first + last)
    for low, high in ((first, middle - 0.7), (middle + 0.7, last)):
        if edge == "hedge":
            hedge = box((0.0, 0.0, 0.0), (high - low, 0.6, rng.uniform(0.9, 1.6)), "vegetation")
            site.place("Hedges", "Hedge", hedge, front.place(low, 0.2, z), front.yaw_deg)
        elif edge == "fence":
            # A low wall of masonry.
            wall = box((0.0, 0.0, 0.0), (high - low, 0.24, 0.8), "brick")
            site.place("Fences", "Wall", wall, front.place(low, 0.2, z), front.yaw_deg)


def garden_house(rng: np.random.Generator, house_width: float, house_depth: float) -> Building:
    """A detached house of one or two storeys."""
    opening = Opening(rng.uniform(1.1, 1.9), rng.uniform(0.8, 1.0), 2.35, rng.uniform(2.8, 3.6))
    count = bays(house_width, opening)
    ground = ["window"] * count
    ground[int(rng.integers(count))] = "door"
    return Building(
        house_width, house_depth, int(rng.integers(1, 2, endpoint=True)), wall=drawn(rng, WALLS), roof="brick",
        shape=drawn(rng, (("gable", 0.55), ("hip", 0.3), ("flat", 0.15))), opening=opening,
        glazed=frozenset({"front", "left", "right"}), ground=tuple(ground), pitch=rng.uniform(0.6, 1.0),
    )  # fmt: skip


def square(site: Site, block: Block, rules: Rules) -> None:
    """An open square: a building at its back, trees and benches, bollards along its streets."""
    rng, area = site.rng, block.area
    back = ({"south", "north"} - block.fronts) or {"north"}
    side = sorted(back)[0]
    front = frontage(area, {"south": "north", "north": "south"}[side])
    width, depth = rng.uniform(0.4, 0.65) * area.width, rng.uniform(0.25, 0.35) * area.depth
    hall = Building(
        width, depth, int(rng.integers(2, 3, endpoint=True)), floor_m=4.2, wall=drawn(rng, WALLS), roof="brick",
        shape="hip", opening=Opening(1.6, 1.1, 3.4, 3.4), glazed=frozenset({"front", "left", "right"}),
        ground=("door",), cornice=True, bands=True, pitch=0.7,
    )  # fmt: skip
    position = front.place(0.5 * (front.length - width), area.depth - depth - 1.0)
    site.place("Houses", "Hall", building(hall), position, front.yaw_deg)
    for side in sorted(block.fronts):
        line = frontage(area, side)
        for index in range(int(line.length / 6.0)):
            site.place("Bollards", "Bollard", "Bollard", line.place(3.0 + 6.0 * index, 0.5, rules.kerb_m))
    _trees(site, area.inset(4.0), rules, count=int(rng.integers(6, 14)))
    _benches(site, area.inset(4.0), rules, count=int(rng.integers(4, 9)))


def park(site: Site, block: Block, rules: Rules) -> None:
    """Trees, hedges and benches on grass."""
    area = block.area
    for side in sorted(block.fronts):
        line = frontage(area, side)
        for index in range(int((line.length - 4.0) / 12.0)):
            hedge = box((0.0, 0.0, 0.0), (site.rng.uniform(6.0, 10.0), 0.7, 1.0), "vegetation")
            if site.rng.random() < 0.6:
                site.place("Hedges", "Hedge", hedge, line.place(2.0 + 12.0 * index, 0.4, rules.kerb_m), line.yaw_deg)
    _trees(site, area.inset(3.0), rules, count=int(area.width * area.depth / 70.0))
    _benches(site, area.inset(3.0), rules, count=4)


def _trees(site: Site, area: Rectangle, rules: Rules, count: int) -> None:
    """Trees at random places of a rectangle, as far as they find room."""
    for _ in range(count if area.width > 3.0 and area.depth > 3.0 else 0):
        x, y = site.rng.uniform(area.x0, area.x1), site.rng.uniform(area.y0, area.y1)
        conifer = site.rng.random() < 0.3
        model = f"Conifer_{site.rng.integers(2)}" if conifer else f"Tree_{site.rng.integers(3)}"
        kind = "Conifer" if conifer else "Tree"
        site.place("Trees", kind, model, (x, y, rules.kerb_m), float(site.rng.integers(0, 360)), margin=0.3)


def _benches(site: Site, area: Rectangle, rules: Rules, count: int) -> None:
    for _ in range(count):
        x, y = site.rng.uniform(area.x0, area.x1), site.rng.uniform(area.y0, area.y1)
        site.place("Benches", "Bench", "Bench", (x, y, rules.kerb_m), 90.0 * float(site.rng.integers(4)), margin=0.5)
