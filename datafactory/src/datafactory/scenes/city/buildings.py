"""Buildings: closed bodies with recessed windows, doors and gates, and relief: bands, cornices, balconies.

The front lies in the plane y = 0 from x = 0 to the width and faces -y; the body is behind it. Panes are set back in
their reveals, so that each reveal has right angles that a radar sees. Relief stands before a wall, touches it, and is
closed by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from datafactory.scenes.city.shapes import Polygon, Surface, box, framed_pane, joined, stepped_surface, welded
from datafactory.scenes.motion import Real

FRAME_RECESS = 0.10
"""The frame of a window lies this far [m] behind the wall, its pane 5 cm farther."""
PANE_RECESS = 0.05
FRAME_WIDTH = 0.07
SIDES = ("front", "right", "back", "left")


@dataclass(frozen=True)
class Opening:
    """What repeats along a wall, once a bay.

    :param width, sill, head: of a window [m]: its width, and from the storey's floor to its lower and upper edge
    :param bay: of wall for each window, about [m]
    """

    width: float = 1.3
    sill: float = 1.0
    head: float = 2.45
    bay: float = 2.7


@dataclass(frozen=True)
class Building:
    """The parameters of one building.

    :param width, depth: [m]
    :param floors, floor_m: storeys and the height of each
    :param wall, frame, roof: material keys of the walls, window frames and roof
    :param shape: of the roof: ``"flat"``, ``"gable"`` or ``"hip"``, with the ridge along the front
    :param opening: its windows
    :param glazed: sides with windows, of ``SIDES``
    :param ground: what the bays of the front's ground floor hold: ``"window"``, ``"door"``, ``"shop"``, ``"gate"`` (up
        to the sill) or ``"wall"``; bays beyond the last have windows
    :param base_m: top of the plinth: the ground's level and a step
    :param bands: horizontal bands at the floors of the front
    :param cornice: along the eaves of the front
    :param balconies: (storey from 1, bay) of each, on the front
    :param railing: material key of their railings
    :param pitch: slope of the roof, rise over run
    """

    width: float
    depth: float
    floors: int
    floor_m: float = 3.0
    wall: str = "brick"
    frame: str = "wood"
    roof: str = "brick"
    shape: str = "flat"
    opening: Opening = Opening()
    glazed: frozenset[str] = frozenset({"front"})
    ground: tuple[str, ...] = ()
    base_m: float = 0.27
    bands: bool = False
    cornice: bool = False
    balconies: tuple[tuple[int, int], ...] = ()
    railing: str = "metal"
    pitch: float = 0.8

    @property
    def bays(self) -> int:
        """Of the front."""
        return bays(self.width, self.opening)

    @property
    def eaves(self) -> float:
        """Height of the top of the walls [m]."""
        return self.floors * self.floor_m + 0.4

    @property
    def ridge(self) -> float:
        """Height of the highest point of the roof [m]."""
        return self.eaves + (0.0 if self.shape == "flat" else 0.5 * self.depth * self.pitch)


def bays(length: float, opening: Opening) -> int:
    """Windows side by side on a wall of a length [m]."""
    return max(1, int(length / opening.bay))


DEPTHS = {"wall": 0.0, "window": FRAME_RECESS, "door": 0.30, "shop": 0.35, "gate": FRAME_RECESS}
"""Of openings behind the wall [m]; a gate lies under a window, and both meet in one edge."""
KEYS = {"door": "wood", "shop": "glass", "gate": "metal"}


def building(style: Building) -> Surface:
    """The building, base at z = 0: its body first, then the relief."""
    zs = [0.0, style.base_m]
    for floor in range(style.floors):
        zs += [floor * style.floor_m + style.opening.sill, floor * style.floor_m + style.opening.head]
    zs.append(style.eaves)
    lengths = dict(zip(SIDES, (style.width, style.depth) * 2, strict=True))
    polygons, grids = [], {}
    for side, length in lengths.items():
        grids[side] = _grid_lines(length, style.opening) if side in style.glazed else [0.0, length]
        polygons += _wall(side, grids[side], zs, style)
    polygons += _roof(grids, style)
    centre = np.array([0.5 * style.width, 0.5 * style.depth, 0.0])
    below = _outline(grids, style, 0.0)
    polygons += [Polygon(np.array([centre, second, first]), style.wall) for first, second in _around(below)]
    return joined([welded(polygons), *_relief(style)])


def _grid_lines(length: float, opening: Opening) -> list[float]:
    """[2 bays + 2] where windows begin and end along a wall."""
    count = bays(length, opening)
    bay = length / count
    half = 0.5 * min(opening.width, bay - 0.6)
    lines = [0.0]
    for index in range(count):
        lines += [(index + 0.5) * bay - half, (index + 0.5) * bay + half]
    return [*lines, length]


def _wall(side: str, us: list[float], zs: list[float], style: Building) -> list[Polygon]:
    """One wall with its openings."""
    cells = np.full((len(us) - 1, len(zs) - 1), "wall", dtype=object)
    if len(us) > 2:
        cells[1::2, 2::2] = "window"
    if side == "front" and side in style.glazed:
        for bay, what in enumerate(style.ground[: style.bays]):
            if what in ("door", "shop"):
                cells[1 + 2 * bay, 1:3] = what
            elif what == "gate":
                cells[1 + 2 * bay, 1] = what
            elif what == "wall":
                cells[1 + 2 * bay, 2] = "wall"
    depths = np.vectorize(DEPTHS.__getitem__, otypes=[float])(cells)
    placed = _placing(side, style)
    polygons = []
    for flat in stepped_surface(us, zs, -depths, lambda i, j: cells[i, j]):
        corners = placed(flat.corners)
        # Reveals are upright quads; panes are flat ones at the window's depth.
        is_pane = flat.material == "window" and np.ptp(flat.corners[:, 2]) == 0.0
        if is_pane:
            polygons += framed_pane(corners, FRAME_WIDTH, PANE_RECESS, style.frame)
        else:
            polygons.append(Polygon(corners, KEYS.get(flat.material, style.wall)))
    return polygons


def _placing(side: str, style: Building) -> Callable[[Real], Real]:
    """From (u, v, w) of a wall, w outwards and u to the right as seen from outside, to the building."""

    def placed(corners: Real) -> Real:
        u, v, w = corners.T
        x, y = {
            "front": (u, -w),
            "right": (style.width + w, u),
            "back": (style.width - u, style.depth + w),
            "left": (-w, style.depth - u),
        }[side]
        return np.column_stack([x, y, v])

    return placed


def _outline(grids: dict[str, list[float]], style: Building, z: float) -> list[tuple[float, float, float]]:
    """All corners of the walls at a height, counter-clockwise from above, from (0, 0)."""
    points = []
    for side in SIDES:
        us = np.array(grids[side][:-1])
        flat = _placing(side, style)(np.column_stack([us, np.full(len(us), z), np.zeros(len(us))]))
        points += [(float(x), float(y), float(height)) for x, y, height in flat]
    return points


def _around(points: list[tuple[float, float, float]]) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Neighbours along a closed outline."""
    return list(pairwise([*points, points[0]]))


def _roof(grids: dict[str, list[float]], style: Building) -> list[Polygon]:
    """A flat roof, or one with a ridge along x: fans that meet every corner of the walls."""
    width, depth, eaves, ridge = style.width, style.depth, style.eaves, style.ridge
    if style.shape == "flat":
        centre = np.array([0.5 * width, 0.5 * depth, eaves])
        edge = _around(_outline(grids, style, eaves))
        return [Polygon(np.array([centre, first, second]), style.roof) for first, second in edge]
    inset = min(0.5 * depth, 0.45 * width) if style.shape == "hip" else 0.0
    west, east = (inset, 0.5 * depth, ridge), (width - inset, 0.5 * depth, ridge)
    corners = {"front": (0.0, 0.0), "right": (width, 0.0), "back": (width, depth), "left": (0.0, depth)}
    polygons = []
    for side, nearest, other in (
        ("front", west, east),
        ("right", east, None),
        ("back", east, west),
        ("left", west, None),
    ):
        following = SIDES[(SIDES.index(side) + 1) % 4]
        us = np.array(grids[side][:-1])
        chain = [tuple(point) for point in _placing(side, style)(np.column_stack([us, us * 0.0 + eaves, us * 0.0]))]
        chain.append((*corners[following], eaves))
        if other is not None:
            chain.append(other)
        # Gables are walls; everything that slopes is roof.
        material = style.wall if other is None and style.shape == "gable" else style.roof
        polygons += [Polygon(np.array([nearest, first, second]), material) for first, second in pairwise(chain)]
    return polygons


def _relief(style: Building) -> list[Surface]:
    """Bands, cornice and balconies before the front."""
    parts = []
    if style.bands:
        for floor in range(1, style.floors):
            z = floor * style.floor_m
            parts.append(box((0.0, -0.06, z - 0.1), (style.width, 0.0, z + 0.08), style.wall))
    if style.cornice:
        parts.append(box((0.0, -0.3, style.eaves - 0.28), (style.width, 0.0, style.eaves), style.wall))
    bay = style.width / style.bays
    for floor, index in style.balconies:
        x0, x1 = (index + 0.5) * bay - 1.0, (index + 0.5) * bay + 1.0
        z = floor * style.floor_m + 0.15
        parts.append(box((x0, -1.1, z - 0.15), (x1, 0.0, z), "concrete"))
        parts.append(box((x0, -1.1, z), (x1, -1.06, z + 1.0), style.railing))
        parts.append(box((x0, -1.06, z), (x0 + 0.04, 0.0, z + 1.0), style.railing))
        parts.append(box((x1 - 0.04, -1.06, z), (x1, 0.0, z + 1.0), style.railing))
    return parts
