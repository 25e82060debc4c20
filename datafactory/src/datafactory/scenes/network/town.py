"""A city on a real network: its roads, its traffic, and in the style's manner what stands beside them."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city import furniture, vehicles
from datafactory.scenes.city.buildings import building
from datafactory.scenes.city.city import VERSION, CityOptions
from datafactory.scenes.city.dwellings import garden_house, town_house
from datafactory.scenes.city.footprints import Footprint
from datafactory.scenes.city.rules import RULES, Rules, Style, drawn
from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.city.site import Placement, Site
from datafactory.scenes.city.usd import check_output, write_usd
from datafactory.scenes.city.works import hall_style
from datafactory.scenes.network.conversion import Lane, Network, along, read_network
from datafactory.scenes.network.driving import trajectories
from datafactory.scenes.network.surfaces import PAVEMENT_M, Heights, ground, road_area
from shared.physics.errors import InputError

Real = NDArray[np.float64]

SLOT_M = 8.5
HOUSE_SLOT_M = 3.0
EXTENTS_M = (40.0, 2000.0)
LAND = {Style.INDUSTRIAL: "asphalt", Style.CAR_PARK: "asphalt"}
RAIL_M = 8.0
KINDS = {"Lorry": ("Lorries", "Lorry"), "Bus": ("Buses", "Bus")}
"""Group and kind of the vehicles that are no cars."""


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
    options = CityOptions.checked(seed=seed, style=style)
    if not EXTENTS_M[0] <= extent <= EXTENTS_M[1]:
        raise InputError("city --extent", f"{extent:g}", f"{EXTENTS_M[0]:g} to {EXTENTS_M[1]:g} m")
    with tempfile.TemporaryDirectory() as folder:
        network = read_network(Path(source), form, Path(folder))
        middle = network.centre() if centre is None else centre
        placements, moving = town(network, options, middle, extent, Path(folder))
    made: dict[str, Any] = {"style": options.style.value, "seed": seed, "version": VERSION, form: Path(source).name}
    made |= {"centre_x_m": float(middle[0]), "centre_y_m": float(middle[1]), "extent_m": float(extent)}
    name = f"City on {Path(source).name}: {options.style.value}, seed {seed}. Metres, z up."
    write_usd(out, placements, name, made)
    return moving


def town(
    network: Network, options: CityOptions, centre: tuple[float, float], extent: float, folder: Path
) -> tuple[list[Placement], int]:
    """Everything in the window, ground first, and how many vehicles move."""
    import shapely

    rng, rules = np.random.default_rng(options.seed), RULES[options.style]
    half = 0.5 * extent
    window = shapely.box(centre[0] - half, centre[1] - half, centre[0] + half, centre[1] + half)
    road, heights = road_area(network, window), Heights(network)
    if road.is_empty:
        middle = ", ".join(f"{value:.0f}" for value in network.centre())
        wanted = f"--centre and --extent over its roads, whose middle is ({middle})"
        raise InputError(network.source, f"no road within {half:g} m of ({centre[0]:g}, {centre[1]:g})", wanted)
    site = Site(rng, _models(rng, rules))
    land = LAND.get(options.style, "vegetation")
    site.placements += ground(network, window, road, heights, rules.kerb_m, land)
    beside = _Beside(site, rules, options.style, window, road, heights)
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
    return site.placements, moving


def _models(rng: np.random.Generator, rules: Rules) -> dict[str, Surface]:
    shared = {name: vehicles.car(shape) for name, shape in vehicles.CAR_SHAPES.items()}
    shared |= {"Lorry": vehicles.lorry(), "Bus": vehicles.bus()}
    shared |= {f"Tree_{i}": furniture.street_tree(rng, rng.uniform(1.0, 1.4)) for i in range(3)}
    shared |= {f"Conifer_{i}": furniture.conifer(rng) for i in range(2)}
    shared |= {f"Sign_{kind}": furniture.sign(kind) for kind in ("round", "triangle", "panel")}
    shared |= {"Lamp": furniture.lamp_post(rules.lamp_height_m or 9.0), "Bin": furniture.litter_bin()}
    return shared | {"GuardRail": furniture.guard_rail(RAIL_M, 4.0)}


class _Beside:
    """Places things to the right of lanes, off all roads and within the window."""

    def __init__(self, site: Site, rules: Rules, style: Style, window: Any, road: Any, heights: Heights) -> None:
        import shapely

        self._site, self._rules, self._style = site, rules, style
        self._heights, self._window = heights, window
        x0, y0, x1, y1 = window.bounds
        self._origin = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        self._pavement = PAVEMENT_M if rules.kerb_m else 0.0
        self._road, self._paved = road, road.buffer(self._pavement + 0.2)
        shapely.prepare(self._road)
        shapely.prepare(self._paved)

    def _right_of(self, place: Real, heading_deg: float, aside: float) -> tuple[float, float]:
        angle = math.radians(heading_deg)
        x, y = place[0] + aside * math.sin(angle), place[1] - aside * math.cos(angle)
        return float(x), float(y)

    def _stand(
        self, group: str, kind: str, what: str | Surface, at: tuple[float, float], z: float, yaw: float, off: Any,
        size: tuple[float, float, float, float], margin: float = 0.0,
    ) -> bool:  # fmt: skip
        """Place something if its rectangle is off an area and within the window.

        :param size: from and to in its own x and y [m]
        """
        import shapely

        x0, y0, x1, y1 = size
        cosine, sine = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
        mx, my = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        middle = (at[0] + cosine * mx - sine * my, at[1] + sine * mx + cosine * my)
        corners = Footprint(middle[0], middle[1], x1 - x0, y1 - y0, yaw).corners()
        outline = shapely.Polygon(corners)
        if not self._window.contains(outline) or off.intersects(outline):
            return False
        local = (at[0] - self._origin[0], at[1] - self._origin[1], z)
        return self._site.place(group, kind, what, local, yaw, margin=margin)

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
            # The building's front looks along its own -y: to the left of the lane's heading.
            yaw = heading + 180.0
            aside = 0.5 * lane.width + self._pavement + 0.4 + setback
            corner = self._right_of(place, heading, aside)
            foot = np.array([corner, self._right_of(place, heading, aside + style.depth)])
            z = float(self._heights.at(foot).min()) - 0.1
            size = (0.0, -1.2, style.width, style.depth)
            if self._stand("Houses", "House", building(style), corner, z, yaw, self._paved, size, margin=0.05):
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
        """Lamps, trees, signs, bins and rails along the kerb."""
        rng, rules = self._site.rng, self._rules
        lamp = rng.uniform(2.0, 14.0)
        for number, (place, heading) in enumerate(zip(*along(lane.points, SLOT_M), strict=True)):
            at = self._right_of(place, heading, 0.5 * lane.width + 0.6)
            z = float(self._heights.at(np.array([at]))[0]) + (rules.kerb_m or -0.1)
            round_post = (-0.3, -0.3, 0.3, 0.3)
            if self._style is Style.MOTORWAY:
                first = self._right_of(place, heading, 0.5 * lane.width + 1.0)
                # The rail faces its own -y, which is towards the lane if it runs against the heading.
                z = float(self._heights.at(np.array([first]))[0]) - 0.1
                size = (0.0, -0.1, RAIL_M, 0.15)
                self._stand("Rails", "GuardRail", "GuardRail", first, z, heading + 180.0, self._road, size)
            if rules.lamps_m and number * SLOT_M >= lamp:
                self._stand("Lamps", "Lamp", "Lamp", at, z, heading + 180.0, self._road, round_post)
                lamp += rules.lamps_m
                continue
            what = drawn(rng, (("tree", 0.35), ("sign", 0.12), ("bin", 0.08), ("none", 0.45)))
            if what == "tree":
                behind = self._right_of(place, heading, 0.5 * lane.width + self._pavement + 2.2)
                model = drawn(rng, (("Tree_0", 0.3), ("Tree_1", 0.3), ("Tree_2", 0.2), ("Conifer_0", 0.2)))
                below = float(self._heights.at(np.array([behind]))[0]) - 0.1
                kind, turn = model.split("_")[0], float(rng.integers(0, 360))
                self._stand("Trees", kind, model, behind, below, turn, self._paved, round_post, margin=0.2)
            elif what == "sign":
                model = drawn(rng, (("Sign_round", 0.4), ("Sign_triangle", 0.3), ("Sign_panel", 0.3)))
                self._stand("Signs", "Sign", model, at, z, heading, self._road, round_post)
            elif what == "bin" and rules.walked:
                self._stand("Bins", "Bin", "Bin", at, z, 0.0, self._road, round_post)
