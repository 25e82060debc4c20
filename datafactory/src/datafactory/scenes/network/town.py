"""A city on a real network: its roads, its traffic, and in the style's manner what stands beside them.

Lanes and junctions are joined into one area (shapely), cut to a window, and triangulated with their outline's points
every few metres, so that slopes are followed. A height between lanes is that of the nearest points of their centre
lines. A kerb is an upright face around the area. Roads that pass over others are beyond this: a window has one level.
"""

from __future__ import annotations

import math
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from datafactory.scenes.city.buildings import building
from datafactory.scenes.city.city import VERSION, models
from datafactory.scenes.city.dwellings import garden_house, town_house
from datafactory.scenes.city.roadside import SLOT_M, Piece, pieces_along
from datafactory.scenes.city.rules import RULES, Rules, Style
from datafactory.scenes.city.shapes import Polygon, Surface, welded
from datafactory.scenes.city.site import Placement, Site
from datafactory.scenes.city.usd import check_output, write_usd
from datafactory.scenes.city.works import hall_style
from datafactory.scenes.motion import Real
from datafactory.scenes.network.conversion import Lane, Network, along, read_network, trajectories
from shared.physics.errors import InputError

HOUSE_SLOT_M = 3.0
EXTENTS_M = (40.0, 2000.0)
LAND = {Style.INDUSTRIAL: "bitumen", Style.CAR_PARK: "bitumen"}
"""The same asphalt under a name that is no road's: else all that lies between the roads would be one."""
HEADROOM_M = 2.0
"""What hangs higher than this may reach over a road or a pavement: a lamp's arm, a balcony."""
PASSES_M = 3.5
"""What hangs higher than this no vehicle touches."""
KINDS = {"Lorry": ("Lorries", "Lorry"), "Bus": ("Buses", "Bus")}
"""Group and kind of the vehicles that are no cars."""


OUTLINE_STEP_M = 6.0
NEIGHBOURS = 4
CLOSES_M = 1.0
"""Gaps between lanes and junctions up to twice this are closed: asphalt has none."""
SIMPLER_M = 0.01
PAVEMENT_M = 2.5
LAND_BELOW_M = 0.1
LAND_CELL_M = 10.0
SKIRT_M = 0.6


def write_town(
    out: Path, source: Path, form: str, seed: int = 0, style: Style = Style.OLD_TOWN,
    centre: tuple[float, float] | None = None, extent: float = 300.0,
) -> int:  # fmt: skip
    """Write a city on the road network of a file, as USD: metres, z up, the window's middle at the origin.

    :param source: OpenDRIVE or OpenStreetMap file
    :param form: ``"opendrive"`` or ``"osm"``
    :param centre: of the window, in the network's coordinates [m]; the network's own middle otherwise
    :param extent: side of the window [m]
    :return: vehicles that move
    :raises InputError: a bad argument or file, no road in the window, or SUMO is not installed
    """
    out = check_output(out)
    if not EXTENTS_M[0] <= extent <= EXTENTS_M[1]:
        raise InputError("city --extent", f"{extent:g}", f"{EXTENTS_M[0]:g} to {EXTENTS_M[1]:g} m")
    with tempfile.TemporaryDirectory() as folder:
        network = read_network(Path(source), form, Path(folder))
        middle = network.centre() if centre is None else centre
        placements, moving = town(network, seed, style, middle, extent, Path(folder))
    made: dict[str, Any] = {"style": style.value, "seed": seed, "version": VERSION, form: Path(source).name}
    made |= {"centre_x_m": float(middle[0]), "centre_y_m": float(middle[1]), "extent_m": float(extent)}
    name = f"City on {Path(source).name}: {style.value}, seed {seed}. Metres, z up."
    write_usd(out, placements, name, made)
    return moving


def town(
    network: Network, seed: int, style: Style, centre: tuple[float, float], extent: float, folder: Path
) -> tuple[list[Placement], int]:
    """Everything in the window, ground first, and how many vehicles move."""
    import shapely

    rng, rules = np.random.default_rng(seed), RULES[style]
    half = 0.5 * extent
    window = shapely.box(centre[0] - half, centre[1] - half, centre[0] + half, centre[1] + half)
    road, heights = road_area(network, window), Heights(network, window)
    if road.is_empty:
        middle = ", ".join(f"{value:.0f}" for value in network.centre())
        wanted = f"--centre and --extent over its roads, whose middle is ({middle})"
        raise InputError(network.source, f"no road within {half:g} m of ({centre[0]:g}, {centre[1]:g})", wanted)
    site = Site(rng, models(rng, rules))
    land = LAND.get(style, "vegetation")
    site.placements += ground(road, heights, rules.kerb_m, land)
    beside = _Beside(site, rules, style, road, heights)
    outer = [lane for lane in network.lanes if lane.outermost and not lane.junction]
    for lane in outer:
        beside.buildings(lane)
    for lane in outer:
        beside.furniture(lane)
    moving = 0
    for model, keys in trajectories(network, rules, rng, folder, centre):
        if any(abs(key.position[0]) < half and abs(key.position[1]) < half for key in keys):
            group, kind = KINDS.get(model, ("Cars", "Car"))
            site.add(group, kind, model, keys[0].position, keys[0].yaw_deg, keys)
            moving += 1
    return _out_of_the_way(site), moving


def _out_of_the_way(site: Site) -> list[Placement]:
    """Without what stands where a vehicle passes: a bus cuts corners over what is beside the road."""
    import shapely

    def outline(what: str | Surface, position: tuple[float, float, float], yaw_deg: float) -> Any:
        bodies = [body for body in site.footprints(what, position, yaw_deg) if body.low - position[2] < PASSES_M]
        return shapely.union_all([shapely.Polygon(body.ground.corners()) for body in bodies])

    swept = []
    for item in site.placements:
        passed = [outline(item.model, key.position, key.yaw_deg) for key in item.keyframes]
        swept += [shapely.union(*pair).convex_hull for pair in pairwise(passed)]
    driven = shapely.union_all(swept)
    shapely.prepare(driven)

    def stays(item: Placement) -> bool:
        what = item.model or item.surface
        if item.keyframes or what is None or item.path.startswith("Ground/"):
            return True
        return not driven.intersects(outline(what, item.position, item.yaw_deg))

    return [item for item in site.placements if stays(item)]


class _Beside:
    """Places things to the right of lanes, off all roads and within the window."""

    def __init__(self, site: Site, rules: Rules, style: Style, road: Any, heights: Heights) -> None:
        import shapely

        self._site, self._rules, self._style, self._heights = site, rules, style, heights
        self._pavement = PAVEMENT_M if rules.kerb_m else 0.0
        self._road, self._paved = road, road.buffer(self._pavement + 0.2)
        shapely.prepare(self._road)
        shapely.prepare(self._paved)

    def _right_of(self, place: Real, heading_deg: float, aside: float) -> Real:
        """[2] a place to the right of another, as seen along a heading [m]."""
        angle = math.radians(heading_deg)
        return np.array([place[0] + aside * math.sin(angle), place[1] - aside * math.cos(angle)])

    def _stand(self, item: Piece, at: Real, above: float, off: Any, surface: Surface | None = None) -> bool:
        """Place something if what of it stands on the ground is off an area and within the window.

        :param at: [2] in the network's coordinates [m]
        :param above: the lowest ground under it [m]
        :param surface: its shape, where it is no model that others share
        """
        import shapely

        what = item.model if surface is None else surface
        bodies = self._site.footprints(what, (float(at[0]), float(at[1]), 0.0), item.yaw_deg)
        outlines = [body.ground.corners() for body in bodies if body.low < HEADROOM_M]
        for outline in map(shapely.Polygon, outlines):
            if not self._heights.window.contains(outline) or off.intersects(outline):
                return False
        x, y = (at - self._heights.origin[:2]).tolist()
        z = float(self._heights.at(np.concatenate(outlines)).min()) + above
        return self._site.place(item.group, item.kind, what, (x, y, z), item.yaw_deg, margin=0.05)

    def buildings(self, lane: Lane) -> None:
        """Houses or halls that look at the road, where there is room behind the pavement."""
        if self._style is Style.MOTORWAY:
            return
        rng, clear = self._site.rng, 0.0
        places, headings = along(lane.points, HOUSE_SLOT_M)
        for number, (place, heading) in enumerate(zip(places, headings, strict=True)):
            if number * HOUSE_SLOT_M < clear:
                continue
            style, setback = self._house()
            # The building's front looks along its own -y: against the lane's heading that is to the left, at the road.
            corner = self._right_of(place, heading, 0.5 * lane.width + self._pavement + 0.4 + setback)
            if self._stand(Piece("Houses", "House", "", heading + 180.0), corner, -0.1, self._paved, building(style)):
                gap = 0.0 if self._style is Style.OLD_TOWN and rng.random() < 0.7 else rng.uniform(3.0, 12.0)
                clear = number * HOUSE_SLOT_M + style.width + gap

    def _house(self) -> tuple[Any, float]:
        """A building of the style, and how far behind the pavement it stands [m]."""
        rng = self._site.rng
        if self._style is Style.OLD_TOWN:
            every = frozenset({"front", "left", "right"})
            return town_house(rng, rng.uniform(9.0, 15.0), rng.uniform(9.5, 12.0), 4, every), 0.0
        if self._style is Style.SUBURB:
            return garden_house(rng, rng.uniform(8.5, 11.5), rng.uniform(8.0, 10.0)), rng.uniform(3.0, 8.0)
        return hall_style(rng, rng.uniform(18.0, 40.0), rng.uniform(15.0, 30.0)), rng.uniform(8.0, 16.0)

    def furniture(self, lane: Lane) -> None:
        """Lamps, trees, signs and bins along the kerb; along a motorway rails."""
        places, headings = along(lane.points, SLOT_M)
        beside = 0.5 * lane.width
        if self._style is Style.MOTORWAY:
            for place, heading in zip(places, headings, strict=True):
                # The rail faces its own -y, which is towards the lane if it runs against the heading.
                rail = Piece("Rails", "GuardRail", "GuardRail", heading + 180.0)
                self._stand(rail, self._right_of(place, heading, beside + 1.0), -0.1, self._road)
        slots = [(SLOT_M * number, float(heading)) for number, heading in enumerate(headings)]
        for number, item in pieces_along(self._site.rng, self._rules, slots):
            if item.kind == "Tree":  # behind the pavement, which is too narrow for one
                behind = self._right_of(places[number], headings[number], beside + self._pavement + 2.2)
                self._stand(item, behind, -0.1, self._paved)
            else:
                at = self._right_of(places[number], headings[number], beside + 0.6)
                self._stand(item, at, self._rules.kerb_m or -0.1, self._road)


class Heights:
    """The height of the ground anywhere: a mean of the nearest points of the lanes, weighted by 1 / distance^2.

    :param window: shapely polygon in the network's coordinates; its middle is the world's origin
    """

    def __init__(self, network: Network, window: Any) -> None:
        x0, y0, x1, y1 = window.bounds
        self.window, self.origin = window, np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0])
        points = [np.concatenate([lane.points, along(lane.points, 2.0)[0]]) for lane in network.lanes]
        every = np.concatenate(points)
        self._tree, self._z = KDTree(every[:, :2]), every[:, 2]
        self.level = bool(np.ptp(self._z) < 1e-3)

    def at(self, places: Real) -> Real:
        """[n] heights [m] at [n, 2] in the network's coordinates."""
        distance, index = self._tree.query(places, k=min(NEIGHBOURS, len(self._z)))
        weight = 1.0 / (distance**2 + 1e-6)
        return np.round((weight * self._z[index]).sum(axis=1) / weight.sum(axis=1), 3)


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


def ground(road: Any, heights: Heights, kerb_m: float, land: str) -> list[Placement]:
    """Road, pavement and land within the window.

    :param road: shapely area in the network's coordinates
    :param kerb_m: height of the pavement over the road; 0 for none, and no pavement then
    :param land: material of what lies around
    """
    import shapely

    surfaces = {"Road_0": _flat(road, heights, 0.0, "asphalt")}
    outer = road
    if kerb_m:
        wide = road.buffer(PAVEMENT_M, join_style="mitre", mitre_limit=1.5)
        outer = shapely.set_precision(wide.intersection(heights.window), 0.001)
        pavement = shapely.set_precision(outer.difference(road), 0.001)
        sides = _upright(road, heights, (kerb_m, 0.0), "concrete")
        surfaces["Pavement"] = [*_flat(pavement, heights, kerb_m, "concrete"), *sides]
    surfaces["Edge"] = _upright(outer, heights, (-SKIRT_M, kerb_m), "concrete" if kerb_m else "asphalt")
    x0, y0, x1, y1 = heights.window.bounds
    columns, rows = (max(1, round(size / LAND_CELL_M)) for size in (x1 - x0, y1 - y0))
    columns, rows = (1, 1) if heights.level else (columns, rows)
    lines = np.linspace(x0, x1, columns + 1), np.linspace(y0, y1, rows + 1)
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    below = heights.at(grid.reshape(-1, 2)).reshape(columns + 1, rows + 1) - LAND_BELOW_M
    if not heights.level:
        # Where the land bends between its corners it must not come through the road.
        below -= 2.0 * LAND_BELOW_M
    corners = np.concatenate([grid, below[..., None]], axis=-1) - heights.origin
    cells = []
    for i, j in np.ndindex(columns, rows):
        a, b, c, d = corners[i, j], corners[i + 1, j], corners[i + 1, j + 1], corners[i, j + 1]
        cells += [Polygon(np.array([a, b, c]), land), Polygon(np.array([a, c, d]), land)]
    surfaces["Land"] = cells
    return [Placement(f"Ground/{name}", welded(polygons)) for name, polygons in surfaces.items() if polygons]


def _flat(area: Any, heights: Heights, above: float, material: str) -> list[Polygon]:
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
        found.append(Polygon(np.column_stack([corners, heights.at(corners) + above]) - heights.origin, material))
    return found


def _upright(area: Any, heights: Heights, levels: tuple[float, float], material: str) -> list[Polygon]:
    """Upright faces along the outline of an area, but not along the window's; they face to the first level's side.

    :param levels: heights over the ground at the outside and at the inside of the area: faces look from the higher side
        to the lower one
    """
    import shapely

    found = []
    border = heights.window.exterior.buffer(0.02)
    low, high = sorted(levels)
    for part in shapely.get_parts(shapely.segmentize(area, OUTLINE_STEP_M)):
        for exterior, ring in ((True, part.exterior), *((False, ring) for ring in part.interiors)):
            line = np.array(shapely.normalize(shapely.Polygon(ring)).exterior.coords)
            signed = 0.5 * float(np.sum(line[:-1, 0] * line[1:, 1] - line[1:, 0] * line[:-1, 1]))
            outwards = (signed > 0.0) == exterior
            line = line if outwards else line[::-1]  # the area lies to the left
            z = heights.at(line)
            for (a, za), (b, zb) in pairwise(zip(line, z, strict=True)):
                if border.contains(shapely.LineString([a, b])):
                    continue
                corners = np.array([(*a, za + low), (*b, zb + low), (*b, zb + high), (*a, za + high)]) - heights.origin
                # As written the face looks to the right of the line, away from the area.
                corners = corners if levels[1] == high else corners[::-1]
                found += [Polygon(corners[[0, 1, 2]], material), Polygon(corners[[0, 2, 3]], material)]
    return found
