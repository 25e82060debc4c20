"""The geometry that a process keeps, and what is found of a scene: the same whatever was traced before."""

from __future__ import annotations

import pickle
from dataclasses import fields

import numpy as np
import pytest
from prepared_scenes import EFFECT_SCENES, prepared_scene
from rough_plates import merged_of
from sionna_scenes import FREQUENCY_HZ, box, plate
from turning_scenes import turning

from datafactory.paths import geometry as geometry_module
from datafactory.paths import trace as trace_module
from datafactory.paths.corners import corners_of, points_of
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import edges_of
from datafactory.paths.geometry import Geometry, mesh_of_shape
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import find_shapes
from datafactory.scenes.poses import Pose

pytestmark = pytest.mark.usefixtures("variant")


POSES = tuple(
    Pose((0.4 * n, 0.1 * n, 0.2), yaw_deg=5.0 * n, velocity=(2.0, 0.0, 0.0), time_s=0.1 * n) for n in range(5)
)
SETTINGS = TraceSettings(rays=3_000, depth=2, refraction=True, diffraction=True, corners=True)


def scene() -> MergedScene:
    """What stands, what drives and what turns."""
    return merged_of(
        turning(box("car", (7.0, -2.0, -1.0), (9.0, 2.0, 1.0), "metal")),
        box("house", (20.0, -9.0, -1.0), (25.0, 9.0, 8.0), "concrete"),
        plate("ground", (15.0, 0.0, -1.5), (15.0, 0.0, 0.0), (0.0, 12.0, 0.0), "concrete"),
    )


def traced(merged: MergedScene, pose: Pose) -> PathTable:
    return trace_module.trace(merged, pose, FREQUENCY_HZ, SETTINGS, RayFan(SETTINGS.rays), 1)


def same(one: PathTable, other: PathTable) -> None:
    for kind in ("scattered", "specular"):
        ours, theirs = getattr(one, kind), getattr(other, kind)
        assert len(ours) > 0
        for field in fields(ours):
            np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name))
    assert one.counts == other.counts


def test_a_frame_is_the_same_first_or_fifth():
    merged = scene()
    kept = [traced(merged, pose) for pose in POSES]
    backwards = [traced(merged, pose) for pose in reversed(POSES)]
    for pose, one, other in zip(POSES, kept, reversed(backwards), strict=True):
        same(one, other)
        geometry_module._KEPT.clear()
        same(one, traced(merged, pose))


def test_one_scene_is_kept_and_another_is_another():
    geometry_module._KEPT.clear()
    merged = scene()
    one, other = (geometry_module.placed(merged.at(pose.time_s), pose) for pose in POSES[:2])
    assert one is other
    assert geometry_module.placed(scene().at(0.0), POSES[0]) is not one


def test_a_frame_without_chains_makes_no_scene_of_sionnas(monkeypatch):
    def never(*arguments):
        raise AssertionError("called")

    monkeypatch.setattr(trace_module, "radio_scene", never)
    settings = TraceSettings(rays=1_000, depth=1, refraction=True, diffraction=True, corners=True)
    table = trace_module.trace(scene(), POSES[0], FREQUENCY_HZ, settings, RayFan(1_000), 1)
    assert len(table.scattered) > 300


def test_shapes_are_named_by_their_meshes():
    merged = scene()
    geometry = Geometry(merged).place(merged, POSES[0])
    assert sorted(mesh_of_shape(geometry.mi_scene).values()) == list(range(len(merged.meshes)))
    empty = Geometry(MergedScene((), ())).place(MergedScene((), ()), POSES[0])
    assert mesh_of_shape(empty.mi_scene) == {}


def test_what_was_found_goes_along_and_is_the_same():
    scene = prepared_scene(EFFECT_SCENES / "three_faces.usda").merged
    find_shapes(scene, TraceSettings(corners=True, diffraction=True))
    copy = pickle.loads(pickle.dumps(scene))
    found = set(copy.found)
    pairs = [(find(copy), find(scene)) for find in (edges_of, corners_of, points_of, curved_surfaces_of)]
    assert set(copy.found) == found, "something was found again"
    assert min(len(points_of(scene)), len(corners_of(scene)), len(edges_of(scene))) > 0
    for own, other in pairs:
        for name, values in vars(other).items():
            assert np.array_equal(getattr(own, name), values), name


def test_another_time_of_a_scene_begins_with_nothing_found():
    scene = prepared_scene(EFFECT_SCENES / "moving_car.usda").merged
    find_shapes(scene, TraceSettings())
    assert scene.found
    assert scene.at(0.5).found == {}
