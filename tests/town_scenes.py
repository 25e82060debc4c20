"""Towns of boxes, for tests of free ground, of where a sensor goes, and of traffic."""

from __future__ import annotations

import numpy as np

from datafactory.scenes.scene import Scene, SceneObject

BOX_QUADS = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
BOX_TRIANGLES = np.array([t for a, b, c, d in BOX_QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


def box(name, lower, upper, material="concrete", velocity=(0.0, 0.0, 0.0)):
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    floor = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    vertices = np.array([[x, y, z] for z in (z0, z1) for x, y in floor], dtype=np.float64)
    return SceneObject(name, vertices, BOX_TRIANGLES, material, velocity)


def sheet(name, x, y, height, material="concrete"):
    """A rectangle over x = (low, high), y = (low, high) whose height is a function of x and y."""
    corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    vertices = np.array([[a, b, height(a, b)] for a, b in corners], dtype=np.float64)
    return SceneObject(name, vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), material)


def flat(x, y):
    return 0.0


BUILDINGS = [
    box(f"house-{n}", (n * 40.0 - 95, side - 8, 0.0), (n * 40.0 - 70, side + 8, 12.0))
    for n in range(5)
    for side in (-20.0, 20.0)
]
CAR = box("car", (3.0, 2.0, 0.3), (7.0, 4.0, 1.5), "metal", (8.0, 0.0, 0.0))
POLE = box("pole", (30.0, -3.05, 0.0), (30.1, -2.95, 4.0), "metal")
PLATE = sheet("floor", (-110.0, 110.0), (-50.0, 50.0), flat)
TOWN = Scene("town", (PLATE, *BUILDINGS, CAR, POLE))

SLOPE = 0.04
"""Of the hill on which the two blocks stand."""


def block(name: str, low: tuple[float, float, float], high: tuple[float, float, float], slope: float) -> SceneObject:
    """A box whose floor and roof follow a slope along x."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    corners[:, 2] += slope * corners[:, 0]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    return SceneObject(name, corners, np.array(triangles, dtype=np.int32), "concrete")


def two_blocks(slope: float = SLOPE, half_width: float = 11.0) -> Scene:
    """A street along x between two houses, on a hill."""
    return Scene(
        "two_blocks",
        (
            block("ground", (-70.0, -24.0, -1.0), (70.0, 24.0, 0.0), slope),
            block("north", (-70.0, half_width, -0.5), (70.0, half_width + 10.0, 12.0), slope),
            block("south", (-70.0, -half_width - 10.0, -0.5), (70.0, -half_width, 12.0), slope),
        ),
    )
