"""Houses, trees and people of the shipped street. Metres, z up; a facade faces -y, a house's base lies at z = 0."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.shapes import (
    QUARTER_TURN_X,
    Polygon,
    Surface,
    blob,
    box,
    cylinder,
    framed_pane,
    joined,
    prism,
    stepped_surface,
    welded,
)

FLOOR_HEIGHT = 3.0
WINDOW_RECESS = 0.15
FRAME_RECESS = 0.10
"""The frame lies this far [m] behind the wall, the pane at WINDOW_RECESS."""
DOOR_RECESS = 0.30
PLINTH = 0.27
"""Top of the plinth [m]: pavement level 0.12 m and one step of 0.15 m, on which the door stands."""
ROOF_PITCH = np.radians(38.0)
TORSO_HEIGHT, RIDER_HEIGHT = 1.1, 1.2
"""Of a person's and a cyclist's point of reflection above the ground [m]."""


@dataclass(frozen=True)
class HouseStyle:
    """The parameters of one house.

    :param width: facade width [m]
    :param depth: [m]
    :param floors: storeys of 3 m
    :param wall: material key of the walls
    :param frame: material key of the window frames
    :param gabled: a tiled gable roof instead of a flat one
    :param door_bay: index of the ground-floor bay that holds the door
    """

    width: float
    depth: float
    floors: int
    wall: str
    frame: str
    gabled: bool
    door_bay: int

    @property
    def bays(self) -> int:
        """Window columns: one for every 2.7 m of facade."""
        return max(1, int(self.width / 2.7))


def house(style: HouseStyle) -> Surface:
    """One closed house: facade in the plane y = 0 from x = 0 to ``style.width``, the body behind it at y > 0.

    The facade is a grid of wall, recessed windows (frame and pane) and one recessed door; the other walls are plain.
    """
    bay = style.width / style.bays
    half_window = 0.5 * min(1.4, bay - 1.0)
    xs = [0.0]
    for i in range(style.bays):
        xs += [(i + 0.5) * bay - half_window, (i + 0.5) * bay + half_window]
    xs.append(style.width)
    zs = [0.0, PLINTH]
    for floor in range(style.floors):
        zs += [floor * FLOOR_HEIGHT + 1.15, floor * FLOOR_HEIGHT + 2.5]
    eaves = style.floors * FLOOR_HEIGHT + 0.4
    zs.append(eaves)

    # Columns 1, 3, ... hold openings; rows 2, 4, ... windows; the door takes the two rows above the plinth.
    cells = np.full((len(xs) - 1, len(zs) - 1), "wall", dtype=object)
    cells[1::2, 2::2] = "window"
    cells[1 + 2 * style.door_bay, 1:3] = "door"
    depths = np.select([cells == "window", cells == "door"], [FRAME_RECESS, DOOR_RECESS], 0.0)
    keys = {"wall": style.wall, "window": "window", "door": "wood"}

    polygons: list[Polygon] = []
    for flat in stepped_surface(xs, zs, -depths, lambda i, j: keys[cells[i, j]]):
        u, v, w = flat.corners.T
        corners = np.column_stack([u, -w, v])
        if flat.material == "window":
            polygons += framed_pane(corners, 0.07, WINDOW_RECESS - FRAME_RECESS, style.frame, "glass")
        else:
            polygons.append(Polygon(corners, flat.material))
    return welded(polygons + _shell(np.array(xs), np.array(zs), style))


def _shell(xs: NDArray[np.float64], zs: NDArray[np.float64], style: HouseStyle) -> list[Polygon]:
    """Side walls, back, roof and floor of a house, as fans that meet every grid line of the facade's outline."""
    width, depth, eaves = style.width, style.depth, zs[-1]
    ridge = eaves + (0.5 * depth * np.tan(ROOF_PITCH) if style.gabled else 0.0)
    roof = "brick" if style.gabled else "concrete"
    roof_end_y = 0.5 * depth if style.gabled else depth
    polygons = []

    def fan(apex: tuple[float, float, float], chain: list[tuple[float, float, float]], material: str) -> None:
        for first, second in pairwise(chain):
            polygons.append(Polygon(np.array([apex, first, second]), material))

    peak = [(0.5 * depth, ridge)] if style.gabled else []
    outline = [(0.0, z) for z in zs] + peak + [(depth, eaves)]
    fan((width, depth, 0.0), [(width, y, z) for y, z in reversed(outline)], style.wall)
    fan((0.0, depth, 0.0), [(0.0, y, z) for y, z in outline], style.wall)
    fan((0.0, roof_end_y, ridge), [(x, 0.0, eaves) for x in xs] + [(width, roof_end_y, ridge)], roof)
    fan((0.0, depth, 0.0), [(width, depth, 0.0)] + [(x, 0.0, 0.0) for x in reversed(xs)], style.wall)
    back = [(width, depth, 0.0), (0.0, depth, 0.0), (0.0, depth, eaves), (width, depth, eaves)]
    polygons.append(Polygon(np.array(back), style.wall))
    if style.gabled:
        rear = [(width, depth, eaves), (0.0, depth, eaves), (0.0, 0.5 * depth, ridge), (width, 0.5 * depth, ridge)]
        polygons.append(Polygon(np.array(rear), roof))
    return polygons


def tree(rng: np.random.Generator) -> Surface:
    """Street tree: a wooden trunk and a ragged crown."""
    trunk_height, radius = rng.uniform(2.4, 3.0), rng.uniform(1.1, 1.4)
    crown = blob((radius, radius, 1.4 * radius), 0.2, rng, "vegetation")
    trunk = cylinder(rng.uniform(0.1, 0.17), 0.0, trunk_height + 0.3, 10, "wood")
    return joined([trunk, crown.moved((0.0, 0.0, trunk_height + 1.2 * radius))])


def pedestrian() -> Surface:
    """A person of 1.75 m about the point of reflection: the feet stand at z = -TORSO_HEIGHT.

    The mesh is for viewers alone: the reader replaces it by a point target. The material represents clothing.
    """
    legs = [box((-0.1, y - 0.07, 0.0), (0.1, y + 0.07, 0.85), "rubber") for y in (-0.1, 0.1)]
    torso = box((-0.13, -0.22, 0.85), (0.13, 0.22, 1.5), "rubber")
    head = cylinder(0.1, 1.52, 1.75, 8, "rubber")
    return joined([*legs, torso, head]).moved((0.0, 0.0, -TORSO_HEIGHT))


def cyclist() -> Surface:
    """A rider on a bicycle about the point of reflection: the wheels stand at z = -RIDER_HEIGHT."""
    wheel = cylinder(0.34, -0.02, 0.02, 12, "rubber")
    wheels = [wheel.moved((x, 0.0, 0.34), QUARTER_TURN_X) for x in (-0.52, 0.52)]
    frame = box((-0.45, -0.03, 0.45), (0.45, 0.03, 0.85), "metal")
    handlebar = box((0.42, -0.28, 0.98), (0.46, 0.28, 1.02), "metal")
    rider = prism([(-0.3, -0.2), (0.15, -0.2), (0.15, 0.2), (-0.3, 0.2)], 0.88, 1.5, "rubber")
    head = cylinder(0.1, 1.52, 1.75, 8, "rubber").moved((0.05, 0.0, 0.0))
    return joined([*wheels, frame, handlebar, rider, head]).moved((0.0, 0.0, -RIDER_HEIGHT))
