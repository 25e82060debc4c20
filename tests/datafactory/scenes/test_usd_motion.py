"""Velocities of USD prims: of animations, of point instances, of attributes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, read, write_usda

from datafactory.scenes.readers.usd import read_usd
from shared.physics.errors import InputError

MOVING = """def Xform "car" {
      double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 12: (0, 0, 600), 24: (0, 0, 0) }
      uniform token[] xformOpOrder = ["xformOp:translate"]
      def Mesh "m" {
      CUBE
      }
    }
    def Mesh "house" {
    CUBE
    }""".replace("CUBE", CUBE)


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


def test_a_spinning_wheel_stands_still_and_is_counted(tmp_path: Path) -> None:
    body = f"""def Mesh "wheel" {{
      {CUBE}
      double xformOp:rotateX.timeSamples = {{ 0: 0, 10: 45 }}
      uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }}"""
    scene = read(tmp_path, body)
    assert not scene.objects[0].moves
    assert any(warning.startswith("1 objects turn") for warning in scene.warnings)


def test_point_instances_move(tmp_path: Path) -> None:
    body = f"""def PointInstancer "birds" {{
      point3f[] positions.timeSamples = {{ 0: [(0, 0, 0), (9, 0, 0)], 24: [(3, 0, 0), (9, 0, 4)] }}
      int[] protoIndices = [0, 0]
      rel prototypes = </birds/bird>
      def Mesh "bird" {{
      {CUBE}
      }}
    }}"""
    objects = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").objects
    np.testing.assert_allclose([item.velocity for item in objects], [[3, 0, 0], [0, 0, 4]], atol=1e-9)


def test_the_velocity_attribute_goes_to_all_below_and_turns_with_the_axes(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      custom float3 radar:velocity = (1, 2, 3)
      def Mesh "m" {{
      {CUBE}
      }}
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


@pytest.mark.parametrize("value", ["(nan, 1, 1)", "(0, 0, 0)", "(1, 0, 1)", "(inf, 1, 1)", "(1e38, 1e38, 1e38)"])
@pytest.mark.parametrize("operation", ["scale", "rotateXYZ"])
def test_transforms_that_no_mesh_survives_are_counted_or_one_line(tmp_path: Path, value: str, operation: str) -> None:
    """float32 points far from their origin ask for the transform's norm, which is not defined for NaN."""
    body = f"""def Xform "w" {{
      float3 xformOp:{operation} = {value}
      uniform token[] xformOpOrder = ["xformOp:{operation}"]
      def Mesh "m" {{
        point3f[] points = [(1e6, 0, 0), (1e6, 1, 0), (1e6, 0, 1)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
      }}
    }}
    def Mesh "rest" {{
    {CUBE}
    }}"""
    scene = read(tmp_path, body)
    assert scene.objects[-1].name == "/rest"
    assert np.isfinite(scene.bounds()).all()


def test_a_velocity_that_is_no_number_is_refused(tmp_path: Path) -> None:
    body = f"""def Mesh "m" {{
      {CUBE}
      double3 xformOp:translate.timeSamples = {{ 0: (0, 0, 0), 1: (nan, 0, 0) }}
      uniform token[] xformOpOrder = ["xformOp:translate"]
    }}"""
    with pytest.raises(InputError, match=r"/m moves at \(nan, nan, nan\) m/s; expected at most"):
        read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 1\n startTimeCode = 0\n endTimeCode = 1")
