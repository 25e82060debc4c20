"""Towns of boxes, for tests of free ground, of where a sensor goes, and of traffic."""

from dataclasses import replace
from itertools import product

import numpy as np

from datafactory.scenes.scene import Scene, SceneObject

BOX_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
BOX_TRIANGLES = np.array([t for a, b, c, d in BOX_QUADS for t in ((a, b, c), (a, c, d))], dtype=np.int32)


def box(name, lower, upper, material="concrete", velocity=(0.0, 0.0, 0.0)):
    """A closed box, outward winding, eight shared vertices."""
    vertices = np.array(list(product(*zip(lower, upper, strict=True))), dtype=np.float64)
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
BARE = Scene("town", (PLATE, *BUILDINGS))
TOWN = Scene("town", (*BARE.objects, CAR, POLE))
ROAD = sheet("/World/Main_Street/mesh", (-110.0, 110.0), (-4.0, 4.0), lambda x, y: 0.02)

SLOPE = 0.04
"""Of the hill on which the two blocks stand."""


def block(name: str, low: tuple[float, float, float], high: tuple[float, float, float], slope: float) -> SceneObject:
    """A box whose floor and roof follow a slope along x."""
    upright = box(name, low, high)
    rise = slope * upright.vertices[:, :1] * [0.0, 0.0, 1.0]
    return replace(upright, vertices=upright.vertices + rise)


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
