"""Bodies that turn and drive, and scenes of them."""

from __future__ import annotations

import numpy as np
from sionna_scenes import MATERIALS

from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.scenes.chain import Chain, Operation, Samples, placed
from datafactory.scenes.motion import Moving
from datafactory.scenes.scene import Scene, SceneObject

TURN_DEG_PER_S = 40.0


def turning(item: SceneObject, body: str = "body", yaw: float = TURN_DEG_PER_S, forward: float = 3.0) -> SceneObject:
    """The object, turning about the world's z through (8, 0, 0) and moving along x, for 2 s."""
    times = np.array([0.0, 2.0])
    chain = Chain(
        (
            Operation("translate", Samples(times, np.array([[8.0, 0, 0], [8.0 + 2.0 * forward, 0, 0]]))),
            Operation("rotate", Samples(times, np.array([[0.0], [2.0 * yaw]])), "Z"),
        )
    )
    points = item.vertices - np.array([8.0, 0.0, 0.0])
    vertices, local = placed(points, chain.at(0.0)[0]), (points, np.arange(len(points)))
    return SceneObject(
        item.name, vertices, item.triangles, item.material, motion=Moving(body, chain), local=local
    ).as_it_moves()


def merged_of(*objects: SceneObject) -> MergedScene:
    return merge_scene(Scene("test", objects), MATERIALS)
