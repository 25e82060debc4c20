"""Rough plates of four materials, and a corner of three of them that moves and tilts."""

from __future__ import annotations

import numpy as np
from sionna_scenes import material

from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject

FREQUENCY_HZ = 77.5e9
WAVELENGTH_M = 299_792_458.0 / FREQUENCY_HZ
HERE = Pose((0.0, 0.0, 0.0))

ROUGHNESS = {"concrete": 0.6, "metal": 0.5, "lobed": 0.4, "glass": 0.0}

MATERIALS = MaterialMapping(
    entries={
        item.name: (item, "test")
        for item in (
            material("concrete", 5.24, 1.38, 0.1, ROUGHNESS["concrete"]),
            material("metal", 1.0, 1e7, 0.1, ROUGHNESS["metal"]),
            material("lobed", 5.24, 1.38, 0.1, ROUGHNESS["lobed"], "backscattering"),
            material("glass", 6.31, 1.211, 0.006),
        )
    },
    unknown=(),
)


def plate(name: str, centre, across, up, of: str, velocity=(0.0, 0.0, 0.0)) -> SceneObject:
    """A flat rectangle, centre +- across +- up [m]."""
    c, a, b = (np.array(v, dtype=float) for v in (centre, across, up))
    corners = np.array([c - a - b, c + a - b, c + a + b, c - a + b])
    return SceneObject(name, corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), of, velocity)


CORNER = (
    plate("ahead", (10.0, 0.0, 0.0), (1.0, 8.0, 0.0), (0.0, 0.0, 8.0), "concrete", velocity=(-3.0, 1.0, 0.0)),
    plate("side", (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 1.0, 10.0), "metal"),
    plate("ground", (10.0, 0.0, -2.0), (12.0, 0.0, 0.3), (0.0, 12.0, 0.0), "lobed"),
)


def decibels_of(ratio: float) -> float:
    return float(10.0 * np.log10(ratio))


def merged_of(*objects: SceneObject) -> MergedScene:
    return merge_scene(Scene("test", objects), MATERIALS)
