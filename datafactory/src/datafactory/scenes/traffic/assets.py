"""The shipped vehicles and street furniture as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.motion import Vector
from datafactory.scenes.readers.open import open_scene

Real = NDArray[np.float64]

CARS = ("saloon", "hatchback", "suv", "van")
CAR_SHARES = (0.35, 0.35, 0.2, 0.1)
POLES = ("lamp", "traffic_light", "bollard")
POLE_SHARES = (0.6, 0.15, 0.25)
SIGNS = ("sign_round", "sign_triangle", "sign_octagon", "sign_panel")
LABELS = {
    **dict.fromkeys(CARS, "car"), "truck": "truck", "bus": "bus", **dict.fromkeys(POLES, "pole"),
    **dict.fromkeys(SIGNS, "sign"), "bin": "other", "bench": "other",
}  # fmt: skip
"""Class of every asset, as its file has it."""
REACH_M = 2.2
"""What is higher than this above the ground may reach over others: a lamp's arm."""


@dataclass(frozen=True, eq=False)
class Asset:
    """A thing in its own frame, x ahead, standing at z = 0.

    :param parts: of each mesh a name, its vertices [V, 3] [m], triangles [T, 3] and material
    :param lower, upper: corners of its box [m]
    :param foot: length and width of what of it stands below ``REACH_M``, about the origin [m]
    """

    label: str
    parts: tuple[tuple[str, Real, NDArray[np.int32], str], ...]
    lower: Vector
    upper: Vector
    foot: tuple[float, float]


@lru_cache(maxsize=32)
def asset(name: str) -> Asset:
    """The asset in ``scenes/assets/NAME.usda``."""
    scene = open_scene(f"shipped:assets/{name}")
    parts = tuple(
        (item.name.rpartition("/")[2].lower(), item.vertices, item.triangles, item.material) for item in scene.objects
    )
    points = np.concatenate([vertices for _, vertices, _, _ in parts])
    low = points[points[:, 2] <= REACH_M]
    (a, b, c), (d, e, f) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    half = np.abs(low[:, :2]).max(axis=0)
    return Asset(LABELS[name], parts, (a, b, c), (d, e, f), (2.0 * float(half[0]), 2.0 * float(half[1])))
