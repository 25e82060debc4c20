"""Road surfaces of a network: asphalt, kerbs, pavements and the land around them, with the network's elevation.

Lanes and junctions are joined into one area (shapely), cut to a window, and triangulated with their outline's points
every few metres, so that slopes are followed. A height between lanes is that of the nearest points of their centre
lines. A kerb is an upright face around the area. Roads that pass over others are beyond this: a window has one level.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from datafactory.scenes.city.shapes import Polygon, welded
from datafactory.scenes.city.site import Placement
from datafactory.scenes.network.conversion import Network, along

Real = NDArray[np.float64]

OUTLINE_STEP_M = 6.0
NEIGHBOURS = 4
CLOSES_M = 1.0
"""Gaps between lanes and junctions up to twice this are closed: asphalt has none."""
SIMPLER_M = 0.01
PAVEMENT_M = 2.5
LAND_BELOW_M = 0.1
LAND_CELL_M = 10.0
SKIRT_M = 0.6


class Heights:
    """The height of the ground anywhere: a mean of the nearest points of the lanes, weighted by 1 / distance^2."""

    def __init__(self, network: Network) -> None:
        points = [np.concatenate([lane.points, along(lane.points, 2.0)[0]]) for lane in network.lanes]
        every = np.concatenate(points)
        self._tree, self._z = KDTree(every[:, :2]), every[:, 2]
        self.level = bool(np.ptp(self._z) < 1e-3)

    def at(self, places: Real) -> Real:
        """[n] heights [m] at [n, 2] in the network's coordinates."""
        distance, index = self._tree.query(places, k=min(NEIGHBOURS, len(self._z)))
        weight = 1.0 / (np.atleast_2d(distance) ** 2 + 1e-6)
        return np.round((weight * np.atleast_2d(self._z[index])).sum(axis=1) / weight.sum(axis=1), 3)


def road_area(network: Network, window: Any) -> Any:
    """The asphalt: all lanes and junctions within a window, as a shapely (multi)polygon.

    :param window: shapely polygon
    """
    import shapely

    parts = [
        shapely.LineString(lane.points[:, :2]).buffer(0.5 * lane.width, cap_style="flat", join_style="mitre")
        for lane in network.lanes
    ]
    parts += [shapely.Polygon(outline).buffer(0.0) for outline in network.junctions]
    whole = shapely.union_all(parts).buffer(CLOSES_M, join_style="mitre").buffer(-CLOSES_M, join_style="mitre")
    whole = whole.intersection(window)
    return shapely.set_precision(whole.simplify(SIMPLER_M), 0.001)


def ground(network: Network, window: Any, road: Any, heights: Heights, kerb_m: float, land: str) -> list[Placement]:
    """Road, pavement and land within a window; the world's origin is the middle of the window.

    :param window, road: shapely areas in the network's coordinates
    :param kerb_m: height of the pavement over the road; 0 for none, and no pavement then
    :param land: material of what lies around
    """
    import shapely

    x0, y0, x1, y1 = window.bounds
    origin = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0])
    polygons = _flat(road, heights, 0.0, "asphalt", origin)
    surfaces = {"Road_0": polygons}
    outer = road
    if kerb_m:
        outer = shapely.set_precision(
            road.buffer(PAVEMENT_M, join_style="mitre", mitre_limit=1.5).intersection(window), 0.001
        )
        pavement = shapely.set_precision(outer.difference(road), 0.001)
        sides = _upright(road, heights, (kerb_m, 0.0), "concrete", origin, window)
        surfaces["Pavement"] = [*_flat(pavement, heights, kerb_m, "concrete", origin), *sides]
    edge = "concrete" if kerb_m else "asphalt"
    surfaces["Edge"] = _upright(outer, heights, (-SKIRT_M, kerb_m), edge, origin, window)
    columns, rows = (max(1, round(size / LAND_CELL_M)) for size in (x1 - x0, y1 - y0))
    columns, rows = (1, 1) if heights.level else (columns, rows)
    grid = np.stack(
        np.meshgrid(np.linspace(x0, x1, columns + 1), np.linspace(y0, y1, rows + 1), indexing="ij"), axis=-1
    )
    below = heights.at(grid.reshape(-1, 2)).reshape(columns + 1, rows + 1) - LAND_BELOW_M
    if not heights.level:
        # Where the land bends between its corners it must not come through the road.
        below -= 2.0 * LAND_BELOW_M
    corners = np.concatenate([grid, below[..., None]], axis=-1) - origin
    cells = []
    for i, j in np.ndindex(columns, rows):
        a, b, c, d = corners[i, j], corners[i + 1, j], corners[i + 1, j + 1], corners[i, j + 1]
        cells += [Polygon(np.array([a, b, c]), land), Polygon(np.array([a, c, d]), land)]
    surfaces["Land"] = cells
    return [Placement(f"Ground/{name}", welded(polygons)) for name, polygons in surfaces.items() if polygons]


def _flat(area: Any, heights: Heights, above: float, material: str, origin: Real) -> list[Polygon]:
    """The area as triangles that face up."""
    import shapely

    if area.is_empty:
        return []
    fine = shapely.segmentize(area, OUTLINE_STEP_M)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(fine))
    found = []
    for triangle in triangles:
        corners = np.array(triangle.exterior.coords)[:3]
        (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
        if abs(ax * by - ay * bx) < 1e-4:
            continue  # a sliver of 0.5 cm^2 or less
        corners = corners if ax * by - ay * bx > 0.0 else corners[::-1]
        found.append(Polygon(np.column_stack([corners, heights.at(corners) + above]) - origin, material))
    return found


def _upright(
    area: Any, heights: Heights, levels: tuple[float, float], material: str, origin: Real, window: Any
) -> list[Polygon]:
    """Upright faces along the outline of an area, but not along the window's; they face to the first level's side.

    :param levels: heights over the ground at the outside and at the inside of the area: faces look from the higher side
        to the lower one
    """
    import shapely

    found = []
    border = window.exterior.buffer(0.02)
    low, high = sorted(levels)
    for part in shapely.get_parts(shapely.segmentize(area, OUTLINE_STEP_M)):
        for ring in (part.exterior, *part.interiors):
            line = np.array(shapely.normalize(shapely.Polygon(ring)).exterior.coords)
            signed = 0.5 * float(np.sum(line[:-1, 0] * line[1:, 1] - line[1:, 0] * line[:-1, 1]))
            outwards = (signed > 0.0) == (ring is part.exterior)
            line = line if outwards else line[::-1]  # the area lies to the left
            z = heights.at(line)
            for (a, za), (b, zb) in zip(
                zip(line[:-1], z[:-1], strict=True), zip(line[1:], z[1:], strict=True), strict=True
            ):
                if border.contains(shapely.LineString([a, b])):
                    continue
                corners = np.array([(*a, za + low), (*b, zb + low), (*b, zb + high), (*a, za + high)]) - origin
                # As written the face looks to the right of the line, away from the area.
                corners = corners if levels[1] == high else corners[::-1]
                found += [Polygon(corners[[0, 1, 2]], material), Polygon(corners[[0, 2, 3]], material)]
    return found
