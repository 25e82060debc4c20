"""The ground of a city: roads, pavements behind kerbs, plots. One terrace over a grid, cut into a surface for each use.

A kerb is an upright face between two cells of different height, so that it makes a right angle with the road, which a
radar sees from far away. At pedestrians' crossings kerbs are lowered to 3 cm (DIN 18040-3).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.scenes.city.plan import ZEBRA_M, Plan, Rectangle
from datafactory.scenes.city.shapes import Surface, stepped_surface, welded
from datafactory.scenes.city.site import Placement

LOWERED_KERB_M = 0.03
MATERIALS = {
    "Road_0": "asphalt", "Pavement": "concrete", "Lowered_kerb": "concrete", "Median": "vegetation",
    "Plot": "vegetation", "Court": "concrete", "Asphalt_yard": "asphalt",
}  # fmt: skip
GROUND_OF_USE = {
    "houses": "Plot", "gardens": "Plot", "park": "Plot", "verge": "Plot", "square": "Court",
    "works": "Asphalt_yard", "depot": "Asphalt_yard", "parking": "Asphalt_yard",
}  # fmt: skip


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
