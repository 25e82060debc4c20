"""Velocities of USD prims: of animations, of point instances, of attributes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, MOVING, SPLINE, cube, ops, read, write_usda

from datafactory.scenes.motion import Moving
from datafactory.scenes.readers.usd import read_usd


def test_velocity_is_the_first_interval_in_world_metres_per_second(tmp_path: Path) -> None:
    # 600 cm in 12 frames at 24 a second along the stage's z, which is -y with y up turned to z up.
    metadata = 'metersPerUnit = 0.01\n upAxis = "Y"\n timeCodesPerSecond = 24\n startTimeCode = 0\n endTimeCode = 24'
    car, house = read(tmp_path, MOVING, metadata).objects
    assert car.velocity == pytest.approx((0, -12.0, 0), abs=1e-9)
    assert not house.moves
    np.testing.assert_allclose(car.vertices.mean(axis=0), 0, atol=1e-12)


def test_a_start_within_the_animation_takes_its_interval_and_place(tmp_path: Path) -> None:
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 18\n endTimeCode = 24"
    car = read(tmp_path, MOVING, metadata).objects[0]
    assert car.velocity == pytest.approx((0, 0, -1200.0))
    np.testing.assert_allclose(car.vertices.mean(axis=0), [0, 0, 300], atol=1e-9)


def test_every_segment_of_a_track_counts(tmp_path: Path) -> None:
    body = f"""def Mesh "m" {{
      {CUBE}
      {ops(translate={0: (10, 0, 0), 24: (14, 0, 0), 48: (14, 4, 0), 96: (6, 4, 0)})}
    }}"""
    scene = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24")
    item = scene.objects[0]
    for time, place, velocity in (
        (0.0, (10, 0, 0), (4, 0, 0)),
        (0.5, (12, 0, 0), (4, 0, 0)),
        (1.0, (14, 0, 0), (0, 4, 0)),
        (1.5, (14, 2, 0), (0, 4, 0)),
        (3.0, (10, 4, 0), (-4, 0, 0)),
        (4.0, (6, 4, 0), (0, 0, 0)),
        (9.0, (6, 4, 0), (0, 0, 0)),
    ):
        now = item.at(time)
        np.testing.assert_allclose(now.vertices.mean(axis=0), place, atol=1e-9)
        np.testing.assert_allclose(now.velocities, np.tile(velocity, (8, 1)), atol=1e-9)
    assert item.velocity == pytest.approx((4, 0, 0))
    np.testing.assert_allclose(scene.at(1.5).objects[0].vertices.mean(axis=0), (14, 2, 0), atol=1e-9)


def test_objects_of_one_track_are_one_motion(tmp_path: Path) -> None:
    objects = read(tmp_path, MOVING.replace('def Mesh "house"', 'def Sphere "far" {}\n def Mesh "house"')).objects
    both = read(tmp_path, MOVING + "\n" + MOVING.replace('"car"', '"other"').replace('"house"', '"barn"')).objects
    assert objects[0].motion is not None
    assert objects[1].motion is None
    assert both[0].motion == both[2].motion


def test_what_turns_by_itself_is_a_body_by_itself(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      {ops(translate={0: (100, 0, 0), 24: (100, 12, 0)}, rotateZ={0: 0, 24: 30})}
      def Mesh "wheel" {{
        {CUBE}
        {ops(translate=(0, 2, 0), rotateX={0: 0, 24: 720})}
      }}
      {cube("body")}
    }}"""
    motions = [item.motion for item in read(tmp_path, body).objects]
    assert [motion.body for motion in motions if isinstance(motion, Moving)] == ["/car/wheel", "/car"]


def test_what_is_odd_about_an_animation_is_said(tmp_path: Path) -> None:
    body = f"""def Mesh "m" {{
      {CUBE}
      token visibility.timeSamples = {{ 0: "inherited", 5: "invisible" }}
      double3 xformOp:translate.timeSamples = {{ -24: (0, 0, 0), 0: (1, 0, 0), 24: None,
        48: (9, 0, 0), 72: (10, 0, 0) }}
      uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Sphere "s" {{
      double radius.timeSamples = {{ 0: 1, 24: 2 }}
    }}
    def Mesh "driven" {{
      {CUBE}
      custom double3 radar:velocity = (1, 0, 0)
      {ops(rotateZ={0: 0, 24: 90})}
    }}"""
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 24\n endTimeCode = 0"
    scene = read(tmp_path, body, metadata)
    assert set(scene.warnings) == {
        "startTimeCode 24 lies after endTimeCode 0: time 0 is that of 0",
        "1 animations have samples before startTimeCode or after endTimeCode, which count too",
        "1 gaps in animations (samples without a value) hold the value before them",
        "1 prims appear or vanish: taken as at the start",
        "1 solids change their size: taken as they are at the start",
        "1 objects have radar:velocity and time samples: the attribute says how they move",
    }
    item = scene.objects[0]
    places = [float(item.at(time).vertices[:, 0].mean()) for time in (-1.0, 0.0, 0.5, 1.0, 1.9, 2.0, 2.5, 3.0)]
    assert places == pytest.approx([0.0, 1.0, 1.0, 1.0, 1.0, 9.0, 9.5, 10.0])
    assert float(item.at(2.5).velocities[0, 0]) == pytest.approx(1.0)
    driven = scene.objects[2].at(2.0)
    np.testing.assert_allclose(driven.vertices.mean(axis=0), [2, 0, 0], atol=1e-9)


def test_a_turning_target_points_where_its_prim_does(tmp_path: Path) -> None:
    body = """def Xform "t" {
      custom token radar:target = "car"
      double3 xformOp:translate.timeSamples = { 0: (10, 0, 0), 24: (10, 6, 0) }
      double xformOp:rotateZ.timeSamples = { 0: 0, 24: 90 }
      uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }"""
    (target,) = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").targets
    now = target.at(0.5)
    assert now.position == pytest.approx((10, 3, 0))
    assert now.velocity == pytest.approx((0, 6, 0))
    np.testing.assert_allclose(now.axes[0], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-12)
    assert now.spin == pytest.approx((0, 0, np.pi / 2))
    assert target.velocity == pytest.approx((0, 6, 0))


def test_a_spline_is_followed(tmp_path: Path) -> None:
    item = read(tmp_path, SPLINE, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").objects[0]
    places = [float(item.at(time).vertices[:, 0].mean()) for time in (0.0, 0.5, 1.0, 1.9, 2.0, 3.0)]
    assert places == pytest.approx([0, 3, 6, 6, 10, 10])
    assert float(item.at(0.5).velocities[0, 0]) == pytest.approx(6.0)
    assert float(item.at(1.5).velocities[0, 0]) == 0.0


def test_the_velocity_attribute_goes_to_all_below_and_turns_with_the_axes(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      custom float3 radar:velocity = (1, 2, 3)
      {cube("m")}
    }}"""
    item = read(tmp_path, body, 'metersPerUnit = 0.01\n upAxis = "Y"').objects[0]
    assert item.velocity == pytest.approx((1, -3, 2))  # metres per second whatever the stage's unit


def test_the_same_file_gives_the_same_scene(tmp_path: Path) -> None:
    path = write_usda(
        tmp_path, MOVING + '\ndef Xform "l" (references = </l>) {\n}'
    )  # a cycle: USD names layers by address
    first, second = read_usd(path), read_usd(path)
    assert first.content_hash() == second.content_hash()
    assert first.warnings == second.warnings
    assert any("composition errors" in warning and "anon:" not in warning for warning in first.warnings)
