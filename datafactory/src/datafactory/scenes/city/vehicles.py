"""Vehicles of the procedural city. Metres, z up; x is forward, wheels stand at z = 0.

Every part is closed, and its normals point outwards. The wavelength at 77 GHz is 3.9 mm: meshes hold panes in their
frames, wheels and axles, and leave the grain of a surface to its material.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.shapes import QUARTER_TURN_X, Polygon, Surface, box, cylinder, framed_pane, joined, welded


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


def _wheels(axles: tuple[float, ...], half_width: float, radius: float) -> list[Surface]:
    """Two wheels on each axle, their outer flanks at ``half_width``."""
    wheel = cylinder(radius, -0.14, 0.14, 12, "rubber")
    centre = half_width - 0.14
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
                    polygons += framed_pane(quad, 0.08, 0.02, "metal", "glass")
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
