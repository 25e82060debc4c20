"""The parts of the procedural city: houses, cars, street furniture, trees, people. Metres, z up.

Every part is closed, and its normals point outwards. The wavelength at 77 GHz is 3.9 mm: meshes hold recesses, frames,
kerbs and posts, and leave the grain of a surface to its material. Fronts face -y, vehicles and people face +x. The base
lies at z = 0 unless a docstring states another height.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.shapes import (
    QUARTER_TURN_X,
    X_TO_Z_CYCLE,
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

TORSO_HEIGHT = 1.1
"""Height [m] of a person's point of reflection above the ground."""
RIDER_HEIGHT = 1.2


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


@dataclass(frozen=True)
class CarShape:
    """Side view of a car, x forward, z up [m], and its widths.

    :param lower: eight (x, z) from the rear sill up over boot and bonnet to the front sill, convex; the fourth and
        fifth are the ends of the waistline and share one z
    :param roof: x of the roof's rear and front edge
    :param roof_height: z of the roof
    :param half_width: of the body
    :param roof_half_width: of the roof; the side windows lean inwards
    :param axles: x of the rear and front axle
    """

    lower: tuple[tuple[float, float], ...]
    roof: tuple[float, float]
    roof_height: float
    half_width: float
    roof_half_width: float
    axles: tuple[float, float]


CAR_SHAPES = {
    "Saloon": CarShape(
        (
            (-2.15, 0.25),
            (-2.28, 0.55),
            (-2.22, 0.9),
            (-1.6, 0.96),
            (0.95, 0.96),
            (2.05, 0.78),
            (2.28, 0.5),
            (2.2, 0.22),
        ),
        (-0.95, 0.15),
        1.44,
        0.89,
        0.6,
        (-1.38, 1.4),
    ),
    "Hatchback": CarShape(
        (
            (-1.85, 0.25),
            (-1.95, 0.55),
            (-1.92, 0.9),
            (-1.85, 0.97),
            (0.8, 0.97),
            (1.75, 0.8),
            (1.96, 0.5),
            (1.88, 0.22),
        ),
        (-1.5, 0.1),
        1.5,
        0.87,
        0.61,
        (-1.22, 1.25),
    ),
    "Van": CarShape(
        ((-2.4, 0.3), (-2.5, 0.6), (-2.5, 1.1), (-2.46, 1.2), (1.7, 1.2), (2.3, 0.98), (2.5, 0.6), (2.4, 0.28)),
        (-2.36, 1.05),
        1.95,
        0.97,
        0.82,
        (-1.5, 1.55),
    ),
}


def car(shape: CarShape) -> Surface:
    """A closed car body of metal with glass panes in its cabin, and four closed rubber wheels; centre at x = y = 0."""
    lower = np.array(shape.lower)
    left = np.column_stack([lower[:, 0], np.full(len(lower), shape.half_width), lower[:, 1]])
    mirror = np.array([1.0, -1.0, 1.0])
    roof_left = np.array([(x, shape.roof_half_width, shape.roof_height) for x in shape.roof])
    right, roof_right = left * mirror, roof_left * mirror
    rear, front = 3, 4  # where the rear window and the windscreen meet the waistline

    def pane(*corners: NDArray[np.float64]) -> list[Polygon]:
        return framed_pane(np.array(corners), 0.06, 0.01, "metal", "glass")

    # The outline runs counter-clockwise seen from the left; the cabin stands on the edge from rear to front.
    polygons = [Polygon(left, "metal"), Polygon(right[::-1], "metal")]
    ring = [(i, (i + 1) % len(lower)) for i in range(len(lower)) if i != rear]
    polygons += [Polygon(np.array([right[j], left[j], left[i], right[i]]), "metal") for i, j in ring]
    polygons.append(Polygon(np.array([roof_right[0], roof_right[1], roof_left[1], roof_left[0]]), "metal"))
    polygons += pane(left[rear], right[rear], roof_right[0], roof_left[0])
    polygons += pane(right[front], left[front], roof_left[1], roof_right[1])
    polygons += pane(right[rear], right[front], roof_right[1], roof_right[0])
    polygons += pane(left[front], left[rear], roof_left[0], roof_left[1])

    radius, width = 0.32, 0.2
    wheel = cylinder(radius, -0.5 * width, 0.5 * width, 10, "rubber")
    # The tread stands 2 cm outside the flank, so that the body does not hide the wheel from the radar.
    track = shape.half_width + 0.02 - 0.5 * width
    wheels = [wheel.moved((x, side * track, radius), QUARTER_TURN_X) for x in shape.axles for side in (-1.0, 1.0)]
    return joined([welded(polygons), *wheels])


def lamp_post() -> Surface:
    """Steel lamp post, 7 m: mast at the origin, arm and luminaire reaching 1.8 m towards -y."""
    mast = cylinder(0.075, 0.0, 7.0, 12, "metal")
    arm = box((-0.03, -1.4, 6.9), (0.03, 0.0, 6.96), "metal")
    return joined([mast, arm, box((-0.12, -1.8, 6.86), (0.12, -1.3, 6.98), "metal")])


def sign(kind: str) -> Surface:
    """Traffic sign on a post: a 5 mm plate that faces -x, as ``"round"``, ``"triangle"`` or ``"panel"``."""
    angle = 2.0 * np.pi * np.arange(16) / 16
    outlines = {
        "round": 0.3 * np.column_stack([np.cos(angle), np.sin(angle)]),
        "triangle": np.array([(-0.45, -0.26), (0.45, -0.26), (0.0, 0.52)]),
        "panel": np.array([(-0.3, -0.45), (0.3, -0.45), (0.3, 0.45), (-0.3, 0.45)]),
    }
    plate = prism(outlines[kind], 0.0, 0.005, "metal").moved((-0.04, 0.0, 2.45), X_TO_Z_CYCLE)
    return joined([cylinder(0.03, 0.0, 2.9, 12, "metal"), plate])


def bollard() -> Surface:
    """Steel bollard, 1 m."""
    return cylinder(0.06, 0.0, 1.0, 12, "metal")


def litter_bin() -> Surface:
    """Litter bin of sheet metal, 0.9 m."""
    return cylinder(0.24, 0.0, 0.9, 12, "metal")


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
