"""What stands in streets: lamps, signs, signals, rails, shelters, trees, vehicles. Metres, z up, base at z = 0; a
vehicle's x is forward.

Every part is closed, and its normals point outwards. The wavelength at 77 GHz is 3.9 mm: meshes hold panes in their
frames, wheels and axles, and leave the grain of a surface to its material.

A tree's crown at 77 GHz is a volume of leaves, each larger than the wavelength. Here it is a closed, ragged shell of 80
facets of the material *vegetation*: a rough surface that scatters what reaches it, in all directions, from its outside.
Nothing passes through it and nothing moves in it: what stands behind a crown is hidden, and wind has no Doppler.
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
    welded,
)


def lamp_post(height: float = 7.0) -> Surface:
    """Steel lamp post: mast at the origin, arm and luminaire reaching 1.8 m towards -y at its top."""
    mast = cylinder(0.075, 0.0, height, 12, "metal")
    arm = box((-0.03, -1.4, height - 0.1), (0.03, 0.0, height - 0.04), "metal")
    return joined([mast, arm, box((-0.12, -1.8, height - 0.14), (0.12, -1.3, height - 0.02), "metal")])


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


def street_tree(rng: np.random.Generator, radius: float) -> Surface:
    """A tree whose crown stays within 1.2 ``radius`` [m] of its trunk and begins 3.9 m above the ground, or higher.

    Lorries pass below it, as they must (RASt 06 asks for 4.5 m over roads).
    """
    crown = blob((radius, radius, rng.uniform(1.1, 1.6) * radius), 0.2, rng, "vegetation")
    bottom = 3.9 + rng.uniform(0.0, 0.8)
    trunk = cylinder(rng.uniform(0.1, 0.2), 0.0, bottom + 0.5 * radius, 10, "wood")
    return joined([trunk, crown.moved((0.0, 0.0, bottom - crown.vertices[:, 2].min()))])


def conifer(rng: np.random.Generator) -> Surface:
    """A conifer: a trunk under three stacked rings of branches, 6 to 9 m high, at most 1.8 m wide to each side."""
    height, radius = rng.uniform(6.0, 9.0), rng.uniform(1.3, 1.8)
    angle = 2.0 * np.pi * np.arange(9) / 9
    trunk = cylinder(0.14, 0.0, 1.2, 10, "wood")
    rings, bottom = [], 1.2
    for share in (1.0, 0.72, 0.42):
        top = bottom + (height - 1.2) / 3.0
        rx, ry = radius * share * rng.uniform(0.8, 1.0, 2)
        rings.append(prism(np.column_stack([rx * np.cos(angle), ry * np.sin(angle)]), bottom, top, "vegetation"))
        bottom = top
    return joined([trunk, *rings])


def traffic_light() -> Surface:
    """A signal on a post: its head faces -x."""
    return joined([cylinder(0.06, 0.0, 3.4, 12, "metal"), box((-0.36, -0.15, 2.4), (-0.07, 0.15, 3.3), "metal")])


def guard_rail(length: float, spacing: float) -> Surface:
    """Steel guard rail from x = 0 to ``length``: a beam of two ribs 0.75 m high that faces -y, posts every ``spacing``.

    The ribs and the sheet between them are those of a W beam (EN 1317, 310 mm high), with square edges.
    """
    beam = [
        box((0.0, 0.0, 0.44), (length, 0.01, 0.75), "metal"),
        box((0.0, -0.08, 0.44), (length, 0.0, 0.54), "metal"),
        box((0.0, -0.08, 0.65), (length, 0.0, 0.75), "metal"),
    ]
    count = max(1, int(length / spacing))
    places = [(index + 0.5) * length / count for index in range(count)]
    return joined([*beam, *(box((x - 0.05, 0.01, 0.0), (x + 0.05, 0.11, 0.72), "metal") for x in places)])


def pedestrian_rail(length: float) -> Surface:
    """Railing of tubes along a kerb from x = 0 to ``length``, 1 m high."""
    posts = [
        box((x - 0.025, -0.025, 0.0), (x + 0.025, 0.025, 0.94), "metal") for x in np.linspace(0.05, length - 0.05, 3)
    ]
    bar = box((0.0, -0.025, 0.94), (length, 0.025, 1.0), "metal")
    return joined([*posts, bar, box((0.08, -0.015, 0.45), (0.5 * length - 0.03, 0.015, 0.49), "metal")])


def barrier(length: float) -> Surface:
    """Concrete safety barrier from x = 0 to ``length``, 0.8 m high and 0.6 m wide (New Jersey profile)."""
    profile = [
        (-0.3, 0.0), (0.3, 0.0), (0.3, 0.08), (0.11, 0.33), (0.08, 0.8), (-0.08, 0.8), (-0.11, 0.33), (-0.3, 0.08),
    ]  # fmt: skip
    # The profile is not convex at its waist: a foot and a wall that stands on it.
    foot = prism([profile[i] for i in (0, 1, 2, 3, 6, 7)], 0.0, length, "concrete").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE)
    wall = prism([profile[i] for i in (6, 3, 4, 5)], 0.0, length, "concrete").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE)
    return joined([foot, wall])


def bus_shelter() -> Surface:
    """A shelter that opens towards -y: glass panes in steel frames at its back and ends, a roof, a bench."""
    posts = [
        box((x - 0.04, y - 0.04, 0.0), (x + 0.04, y + 0.04, 2.4), "metal") for x in (-2.0, 2.0) for y in (0.0, 1.2)
    ]
    back = box((-1.96, 1.19, 0.3), (1.96, 1.21, 2.1), "glass")
    ends = [box((x - 0.01, 0.04, 0.3), (x + 0.01, 1.16, 2.1), "glass") for x in (-2.0, 2.0)]
    roof = box((-2.2, -0.2, 2.4), (2.2, 1.4, 2.5), "metal")
    bench = box((-1.6, 0.75, 0.42), (1.6, 1.1, 0.47), "wood")
    legs = [box((x - 0.04, 0.85, 0.0), (x + 0.04, 0.95, 0.42), "metal") for x in (-1.3, 1.3)]
    return joined([*posts, back, *ends, roof, bench, *legs])


def fence(length: float) -> Surface:
    """A steel fence from x = 0 to ``length``, 1.8 m high: posts and two rails. A mesh does not hold its thin wires."""
    places = (0.03, 0.5 * length, length - 0.03)
    posts = [box((x - 0.03, -0.03, 0.0), (x + 0.03, 0.03, 1.7), "metal") for x in places]
    low = [box((a + 0.03, -0.02, 0.25), (b - 0.03, 0.02, 0.3), "metal") for a, b in pairwise(places)]
    return joined([*posts, *low, box((0.0, -0.03, 1.7), (length, 0.03, 1.76), "metal")])


def container() -> Surface:
    """A sea container of 20 feet: 6.06 x 2.44 x 2.59 m, its long sides with upright ribs."""
    body = box((-3.03, -1.18, 0.0), (3.03, 1.18, 2.59), "metal")
    places = np.linspace(-2.8, 2.8, 8)
    left = [box((x - 0.1, 1.18, 0.1), (x + 0.1, 1.22, 2.5), "metal") for x in places]
    right = [box((x - 0.1, -1.22, 0.1), (x + 0.1, -1.18, 2.5), "metal") for x in places]
    return joined([body, *left, *right])


def tank(radius: float, height: float) -> Surface:
    """An upright storage tank of sheet steel, 48 sides, on a concrete slab."""
    slab = cylinder(radius + 0.4, 0.0, 0.2, 24, "concrete")
    return joined([slab, cylinder(radius, 0.2, height, 48, "metal")])


def gantry(half_span: float) -> Surface:
    """A sign gantry across a motorway: posts at y = +-``half_span``, a beam, four panels that face -x."""
    posts = [box((-0.2, y - 0.2, 0.0), (0.2, y + 0.2, 5.6), "metal") for y in (-half_span, half_span)]
    beam = box((-0.25, -half_span - 0.2, 5.6), (0.25, half_span + 0.2, 6.3), "metal")
    step = 2.0 * half_span / 4.0
    panels = [
        box((-0.31, -half_span + (i + 0.2) * step, 5.3), (-0.25, -half_span + (i + 0.8) * step, 7.4), "metal")
        for i in range(4)
    ]
    return joined([*posts, beam, *panels])


def noise_wall(length: float, height: float, material: str) -> Surface:
    """A noise barrier from x = 0 to ``length``: panels between steel posts that stand 8 cm before them."""
    panel = box((0.0, -0.06, 0.0), (length, 0.06, height), material)
    posts = [box((x, -0.14, 0.0), (x + 0.16, -0.06, height), "metal") for x in (0.0, 0.5 * length)]
    return joined([panel, *posts])


def bench() -> Surface:
    """A bench of wood on two feet of concrete."""
    feet = [box((x - 0.1, -0.2, 0.0), (x + 0.1, 0.2, 0.42), "concrete") for x in (-0.6, 0.6)]
    return joined([*feet, box((-0.9, -0.22, 0.42), (0.9, 0.22, 0.48), "wood")])


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
        ((-2.15, 0.25), (-2.28, 0.55), (-2.22, 0.9), (-1.6, 0.96),
         (0.95, 0.96), (2.05, 0.78), (2.28, 0.5), (2.2, 0.22)),
        roof=(-0.95, 0.15), roof_height=1.44, half_width=0.89, roof_half_width=0.6, axles=(-1.38, 1.4),
    ),
    "Hatchback": CarShape(
        ((-1.85, 0.25), (-1.95, 0.55), (-1.92, 0.9), (-1.85, 0.97),
         (0.8, 0.97), (1.75, 0.8), (1.96, 0.5), (1.88, 0.22)),
        roof=(-1.5, 0.1), roof_height=1.5, half_width=0.87, roof_half_width=0.61, axles=(-1.22, 1.25),
    ),
    "Van": CarShape(
        ((-2.4, 0.3), (-2.5, 0.6), (-2.5, 1.1), (-2.46, 1.2),
         (1.7, 1.2), (2.3, 0.98), (2.5, 0.6), (2.4, 0.28)),
        roof=(-2.36, 1.05), roof_height=1.95, half_width=0.97, roof_half_width=0.82, axles=(-1.5, 1.55),
    ),
}  # fmt: skip


def car(shape: CarShape) -> Surface:
    """A closed car body of metal with glass panes in its cabin, and four closed rubber wheels; centre at x = y = 0."""
    lower = np.array(shape.lower)
    left = np.column_stack([lower[:, 0], np.full(len(lower), shape.half_width), lower[:, 1]])
    mirror = np.array([1.0, -1.0, 1.0])
    roof_left = np.array([(x, shape.roof_half_width, shape.roof_height) for x in shape.roof])
    right, roof_right = left * mirror, roof_left * mirror
    rear, front = 3, 4  # where the rear window and the windscreen meet the waistline

    def pane(*corners: NDArray[np.float64]) -> list[Polygon]:
        return framed_pane(np.array(corners), 0.06, 0.01, "metal")

    # The outline runs counter-clockwise seen from the left; the cabin stands on the edge from rear to front.
    polygons = [Polygon(left, "metal"), Polygon(right[::-1], "metal")]
    ring = [(i, (i + 1) % len(lower)) for i in range(len(lower)) if i != rear]
    polygons += [Polygon(np.array([right[j], left[j], left[i], right[i]]), "metal") for i, j in ring]
    polygons.append(Polygon(np.array([roof_right[0], roof_right[1], roof_left[1], roof_left[0]]), "metal"))
    polygons += pane(left[rear], right[rear], roof_right[0], roof_left[0])
    polygons += pane(right[front], left[front], roof_left[1], roof_right[1])
    polygons += pane(right[rear], right[front], roof_right[1], roof_right[0])
    polygons += pane(left[front], left[rear], roof_left[0], roof_left[1])

    # The tread stands 2 cm outside the flank, so that the body does not hide the wheel from the radar.
    return joined([welded(polygons), *_wheels(shape.axles, shape.half_width + 0.02, 0.32, 0.2, 10)])


def _wheels(
    axles: tuple[float, ...], half_width: float, radius: float, width: float = 0.28, sides: int = 12
) -> list[Surface]:
    """Two wheels on each axle, their outer flanks at ``half_width``."""
    wheel = cylinder(radius, -0.5 * width, 0.5 * width, sides, "rubber")
    centre = half_width - 0.5 * width
    return [wheel.moved((x, side * centre, radius), QUARTER_TURN_X) for x in axles for side in (-1.0, 1.0)]


def _glazed_box(
    lower: tuple[float, float, float], upper: tuple[float, float, float], glazed: dict[str, tuple[float, float, int]]
) -> Surface:
    """A box of metal with panes in its sides.

    :param glazed: by side (``front`` +x, ``rear`` -x, ``left`` +y, ``right`` -y): lower and upper edge of its panes
        [m], the same on all sides, and how many stand side by side
    """
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    levels = sorted({z0, z1, *(z for low, high, _ in glazed.values() for z in (low, high))})
    corners = {
        "right": ((x0, y0), (x1, y0)),
        "front": ((x1, y0), (x1, y1)),
        "left": ((x1, y1), (x0, y1)),
        "rear": ((x0, y1), (x0, y0)),
    }
    polygons, outline = [], []
    for side, (first, last) in corners.items():
        low, high, count = glazed.get(side, (z0, z1, 0))
        stops = np.linspace(first, last, max(count, 1) + 1)
        outline += [tuple(stop) for stop in stops[:-1]]
        for a, b in pairwise(stops):
            for bottom, top in pairwise(levels):
                quad = np.array([(*a, bottom), (*b, bottom), (*b, top), (*a, top)])
                if count and low <= bottom < high:
                    polygons += framed_pane(quad, 0.08, 0.02, "metal")
                else:
                    polygons.append(Polygon(quad, "metal"))
    for z, turn in ((z1, 1), (z0, -1)):
        middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1), z)
        ring = [(*point, z) for point in outline][::turn]
        for point, following in zip(ring, [*ring[1:], ring[0]], strict=True):
            polygons.append(Polygon(np.array([middle, point, following]), "metal"))
    return welded(polygons)


def lorry() -> Surface:
    """A rigid lorry of 9 m: cab, chassis, a box body of sheet metal, under-run bar, six wheels."""
    panes = dict.fromkeys(("front", "left", "right"), (1.6, 2.55, 1))
    cab = _glazed_box((2.55, -1.2, 0.55), (4.4, 1.2, 2.95), panes)
    body = box((-4.6, -1.27, 1.15), (2.35, 1.27, 3.6), "metal")
    frame = [box((-4.5, y - 0.05, 0.8), (2.5, y + 0.05, 1.05), "metal") for y in (-0.45, 0.45)]
    bar = box((-4.6, -1.1, 0.45), (-4.5, 1.1, 0.55), "metal")
    return joined([cab, body, *frame, bar, *_wheels((-2.6, 3.4), 1.2, 0.5)])


def bus() -> Surface:
    """A city bus of 11.5 m with panes all around, four wheels."""
    panes = {"front": (1.2, 2.65, 1), "rear": (1.2, 2.65, 1), "left": (1.2, 2.65, 7), "right": (1.2, 2.65, 7)}
    body = _glazed_box((-5.75, -1.25, 0.36), (5.75, 1.25, 3.05), panes)
    return joined([body, *_wheels((-2.7, 3.0), 1.3, 0.48)])
