"""A procedural city as USD: plan, ground, blocks, roadside, in this order, from one generator. Nothing in it moves.

The same options give the same file on every machine: all draws come from one NumPy generator, all coordinates are
rounded to the millimetre before they are written, and nothing depends on a library's last digit.

The ground is one terrace over a grid, cut into a surface for each use: roads, pavements behind kerbs, plots. A kerb is
an upright face between two cells of different height, so that it makes a right angle with the road, which a radar sees
from far away. At pedestrians' crossings kerbs are lowered to 3 cm (DIN 18040-3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from datafactory.scenes.city import dwellings, furniture, roadside, works
from datafactory.scenes.city.plan import ZEBRA_M, Block, Plan, Rectangle, draw_plan
from datafactory.scenes.city.rules import RULES, Rules, Style
from datafactory.scenes.city.shapes import Surface, cylinder, stepped_surface, welded
from datafactory.scenes.city.site import Placement, Site
from datafactory.scenes.city.usd import check_output, write_usd

VERSION = 3
"""Of the generator: the same options, version and kind of file give the same bytes."""


LOWERED_KERB_M = 0.03
MATERIALS = {
    "Road_0": "asphalt", "Pavement": "concrete", "Lowered_kerb": "concrete", "Median": "vegetation",
    "Plot": "vegetation", "Court": "concrete", "Asphalt_yard": "asphalt",
}  # fmt: skip
GROUND_OF_USE = {
    "houses": "Plot", "gardens": "Plot", "park": "Plot", "verge": "Plot", "square": "Court",
    "works": "Asphalt_yard", "depot": "Asphalt_yard", "parking": "Asphalt_yard",
}  # fmt: skip


FILLERS: dict[str, Callable[[Site, Block, Rules], None]] = {
    "houses": dwellings.houses, "gardens": dwellings.gardens, "square": dwellings.square, "park": dwellings.park,
    "works": works.works, "depot": works.depot, "parking": works.parking, "verge": works.verge,
}  # fmt: skip
"""What builds on a block, by its use."""


def models(rng: np.random.Generator, rules: Rules, gantry_m: float = 10.0) -> dict[str, Surface]:
    """The shapes that a city's things share, by name; of trees there are several, drawn.

    :param gantry_m: from the middle of the main street to the posts of a gantry
    """
    shared = {name: furniture.car(shape) for name, shape in furniture.CAR_SHAPES.items()}
    shared |= {"Lorry": furniture.lorry(), "Bus": furniture.bus()}
    shared |= {f"Tree_{i}": furniture.street_tree(rng, rng.uniform(1.0, 1.4)) for i in range(3)}
    shared |= {f"Conifer_{i}": furniture.conifer(rng) for i in range(2)}
    shared |= {f"Sign_{kind}": furniture.sign(kind) for kind in ("round", "triangle", "panel")}
    shared |= {"Lamp": furniture.lamp_post(rules.lamp_height_m), "Signal": furniture.traffic_light()}
    shared |= {"Bollard": cylinder(0.06, 0.0, 1.0, 12, "metal"), "Bin": cylinder(0.24, 0.0, 0.9, 12, "metal")}
    shared |= {"Manhole": cylinder(0.3, 0.0, 0.005, 16, "metal")}  # of cast iron, 5 mm above the road
    shared |= {"Bench": furniture.bench(), "Shelter": furniture.bus_shelter()}
    shared |= {"PedestrianRail": furniture.pedestrian_rail(3.0), "Fence": furniture.fence(works.FENCE_M)}
    shared |= {"Container": furniture.container(), "Barrier": furniture.barrier(works.PIECE_M)}
    shared |= {"GuardRail": furniture.guard_rail(works.PIECE_M, 4.0)}
    shared |= {"Gantry": furniture.gantry(gantry_m)}
    height = round(rng.uniform(3.0, 5.0), 1)
    shared |= {f"NoiseWall_{i}": furniture.noise_wall(4.0, height, key) for i, key in enumerate(("concrete", "wood"))}
    return shared


def city(seed: int = 0, style: Style = Style.OLD_TOWN, blocks: int = 2) -> tuple[Placement, ...]:
    """Everything in a city, ground first; options as those of :func:`write_city`."""
    rng, rules = np.random.default_rng(seed), RULES[style]
    plan = draw_plan(rng, rules, blocks)
    site = Site(rng, models(rng, rules, plan.main.kind.kerb + 1.4))
    islands = [island for block in plan.blocks if block.use == "parking" for island in works.islands(block)]
    site.placements += ground(plan, rules.kerb_m, islands)
    if rules.bridges:
        works.equip(site, plan)
    for block in plan.blocks:
        FILLERS[block.use](site, block, rules)
    roadside.furnish(site, plan, rules)
    return tuple(site.placements)


def write_city(path: Path, seed: int = 0, blocks: int = 2, style: Style = Style.OLD_TOWN) -> None:
    """Write a procedural city as USD: metres, z up; the same options give the same bytes.

    :param path: ``.usda``, ``.usdc`` or ``.usd``
    :param seed: 0 or more
    :param blocks: house blocks along the main street, at least 1, with a cross street between neighbours
    :param style: what the city is like
    :raises InputError: a place that cannot be written
    """
    path = check_output(path)
    name = f"Procedural city: {style.value}, seed {seed}, blocks {blocks}. Metres, z up."
    made = {"style": style.value, "seed": seed, "blocks": blocks, "version": VERSION}
    write_usd(path, city(seed, style, blocks), name, made)


def ground(plan: Plan, kerb_m: float, islands: list[Rectangle]) -> list[Placement]:
    """The ground, a placement for each use.

    :param kerb_m: height of the pavements over the road
    :param islands: kerbed islands on plots, as high above them as a pavement is above the road
    """
    painted: list[tuple[Rectangle, str]] = [(plan.bounds, "Plot")]
    painted += [(block.area, GROUND_OF_USE[block.use]) for block in plan.blocks]
    painted += [(island, "Island") for island in islands]
    painted += [(street.strip(street.kind.facade), "Pavement") for street in plan.streets]
    for street, middle in plan.zebras():
        piece = replace(street, start=middle - 0.5 * ZEBRA_M, end=middle + 0.5 * ZEBRA_M)
        painted.append((piece.strip(street.kind.facade), "Lowered_kerb"))
    painted += [(street.strip(street.kind.kerb), "Road_0") for street in plan.streets]
    painted += [(street.strip(street.kind.median_m), "Median") for street in plan.streets if street.kind.median_m]

    bounds = plan.bounds
    xs = sorted({x for item, _ in painted for x in _rounded(item.x0, item.x1) if bounds.x0 <= x <= bounds.x1})
    ys = sorted({y for item, _ in painted for y in _rounded(item.y0, item.y1) if bounds.y0 <= y <= bounds.y1})
    uses = np.full((len(xs) - 1, len(ys) - 1), "Plot", dtype=object)
    for item, use in painted:
        columns, rows = np.searchsorted(xs, _rounded(item.x0, item.x1)), np.searchsorted(ys, _rounded(item.y0, item.y1))
        uses[columns[0] : columns[1], rows[0] : rows[1]] = use
    levels = dict.fromkeys(["Pavement", "Plot", "Court", "Asphalt_yard", "Median"], kerb_m)
    levels |= {"Lowered_kerb": min(LOWERED_KERB_M, kerb_m), "Island": 2.0 * kerb_m, "Road_0": 0.0}
    heights = [[levels[use] for use in row] for row in uses]
    # An island's kerb is of concrete, as a pavement's; both are one surface.
    uses[uses == "Island"] = "Pavement"
    polygons = stepped_surface(xs, ys, heights, lambda i, j: uses[i, j])
    placements = []
    for name in sorted({polygon.material for polygon in polygons}):
        surface = welded(polygon for polygon in polygons if polygon.material == name)
        surface = Surface(surface.vertices, surface.faces, (MATERIALS[name],) * len(surface.faces))
        placements.append(Placement(f"Ground/{name}", surface))
    return placements


def _rounded(first: float, last: float) -> tuple[float, float]:
    return round(first, 3), round(last, 3)
