"""What is said of poses at which everything that had samples stands still."""

from __future__ import annotations

from dataclasses import replace

from sionna_scenes import box

from datafactory.run.preparation import _late_poses
from datafactory.scenes.motion import Track
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject

CAR = box("car", (5.0, 0.0, 0.0), (9.0, 2.0, 1.5), "metal")
TRACK = Track((0.0, 2.0), ((0.0, 0.0, 0.0), (6.0, 0.0, 0.0)), ((3.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
POSES = tuple(Pose((0.0, 0.0, 0.5), time_s=time) for time in (0.0, 1.9, 2.0, 7.0))


def test_poses_after_the_last_sample_are_counted() -> None:
    driven = SceneObject.of("driven", CAR.vertices, CAR.triangles, "metal", motion=TRACK)
    scene = Scene("street", (CAR, driven))
    expected = "street: 2 of 4 poses are not before 2 s, from when on what has samples rests"
    assert _late_poses(scene, POSES) == expected
    assert _late_poses(scene, POSES[:2]) == ""


def test_what_goes_straight_on_never_ends() -> None:
    scene = Scene("street", (replace(CAR, velocity=(1.0, 0.0, 0.0)),))
    assert _late_poses(scene, POSES) == ""
