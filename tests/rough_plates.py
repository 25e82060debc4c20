"""Rough plates of four materials, and a corner of three of them that moves and tilts."""

from __future__ import annotations

import numpy as np
from sionna_scenes import mapping, material, plate

from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject

HERE = Pose((0.0, 0.0, 0.0))
ROUGHNESS = {"concrete": 0.6, "metal": 0.5, "lobed": 0.4, "glass": 0.0}
MATERIALS = mapping(
    material("concrete", 5.24, 1.38, 0.1, ROUGHNESS["concrete"]),
    material("metal", 1.0, 1e7, 0.1, ROUGHNESS["metal"]),
    material("lobed", 5.24, 1.38, 0.1, ROUGHNESS["lobed"], "backscattering"),
    material("glass", 6.31, 1.211, 0.006),
)

CORNER = (
    plate("ahead", (10.0, 0.0, 0.0), (1.0, 8.0, 0.0), (0.0, 0.0, 8.0), "concrete", velocity=(-3.0, 1.0, 0.0)),
    plate("side", (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 1.0, 10.0), "metal"),
    plate("ground", (10.0, 0.0, -2.0), (12.0, 0.0, 0.3), (0.0, 12.0, 0.0), "lobed"),
)


def decibels_of(ratio: float) -> float:
    return float(10.0 * np.log10(ratio))


def merged_of(*objects: SceneObject) -> MergedScene:
    return merge_scene(Scene("test", objects), MATERIALS)
