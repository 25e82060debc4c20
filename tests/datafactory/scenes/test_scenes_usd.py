"""USD to metres, z up and triangles, on small stages written here; test_reference_stages.py reads others'."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, area, cube, ops, read, signed_volume, translated

from shared.physics.errors import InputError


def test_nested_transforms_are_applied_from_the_inside_out(tmp_path: Path) -> None:
    # Inner: move by (1, 0, 0). Outer: turn by 90 deg about z, then move by (0, 0, 5).
    body = f"""def Xform "outer" {{
      {ops(translate=(0, 0, 5), rotateZ=90)}
      def Xform "inner" {{
        {translated(1, 0, 0)}
        {cube("m")}
      }}
    }}"""
    item = read(tmp_path, body).objects[0]
    assert item.name == "/outer/inner/m"
    np.testing.assert_allclose(item.vertices.mean(axis=0), [0, 1, 5], atol=1e-12)


def test_transforms_far_from_the_origin_keep_float64(tmp_path: Path) -> None:
    body = f'def Mesh "m" {{\n{CUBE}\n{translated(1e6, 0, 0.123456789)}}}'
    scene = read(tmp_path, body)
    assert scene.objects[0].vertices[:, 2].max() == pytest.approx(1.123456789, abs=1e-12)
    assert not any("float32" in warning for warning in scene.warnings)  # 1.2e-7 m apart about their own origin


def test_float32_points_far_from_their_origin_are_said_with_the_figure(tmp_path: Path) -> None:
    far = CUBE.replace("(-1,", "(500000,").replace("(1,", "(500001,")
    scene = read(tmp_path, f'def Mesh "m" {{\n{far}\n}}')
    assert any("31 mm apart" in warning and "2889 deg" in warning for warning in scene.warnings)


def test_instances_are_expanded(tmp_path: Path) -> None:
    body = f"""class Xform "car" {{
      {cube("m")}
    }}
    def Xform "a" (instanceable = true
     inherits = </car>) {{
      {translated(5, 0, 0)}
    }}
    def Xform "b" (instanceable = true
     inherits = </car>) {{
      {translated(0, 7, 0)}
    }}"""
    objects = read(tmp_path, body).objects
    assert [item.name for item in objects] == ["/a/m", "/b/m"]
    np.testing.assert_allclose([item.vertices.mean(axis=0) for item in objects], [[5, 0, 0], [0, 7, 0]], atol=1e-12)


def test_point_instancers_are_expanded_without_their_prototypes_and_hidden_instances(tmp_path: Path) -> None:
    body = f"""def PointInstancer "trees" {{
      point3f[] positions = [(10, 0, 0), (20, 0, 0), (30, 0, 0)]
      float3[] scales = [(1, 1, 1), (1, 1, 1), (2, 2, 2)]
      int[] protoIndices = [0, 0, 0]
      int64[] ids = [4, 5, 6]
      int64[] invisibleIds = [5]
      rel prototypes = </trees/shapes/tree>
      {translated(0, 100, 0)}
      over "shapes" {{
        def Mesh "tree" {{
        {CUBE}
        {translated(0, 0, 1)}
        }}
      }}
    }}"""
    objects = read(tmp_path, body).objects
    assert [item.name for item in objects] == ["/trees[0]/tree", "/trees[2]/tree"]
    centres = [item.vertices.mean(axis=0) for item in objects]
    np.testing.assert_allclose(centres, [[10, 100, 1], [30, 100, 2]], atol=1e-12)
    assert [signed_volume(item) for item in objects] == pytest.approx([8.0, 64.0])


def test_material_subsets_split_a_mesh_and_leave_the_rest(tmp_path: Path) -> None:
    body = f"""def Material "steel" {{}}
    def Material "glass" {{}}
    def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
      {CUBE}
      rel material:binding = </steel>
      uniform token subsetFamily:materialBind:familyType = "nonOverlapping"
      def GeomSubset "pane" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1, 5]
        rel material:binding = </glass>
      }}
    }}"""
    objects = read(tmp_path, body).objects
    assert [(item.name, item.material) for item in objects] == [("/m/pane", "glass"), ("/m", "steel")]
    assert [area(item) for item in objects] == pytest.approx([8.0, 16.0])


def test_an_inherited_material_and_the_radar_override(tmp_path: Path) -> None:
    body = f"""def Material "steel" {{}}
    def Xform "a" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
      rel material:binding = </steel>
      {cube("m")}
      def Xform "b" {{
        custom token radar:material = "itu_glass"
        {cube("m")}
      }}
    }}"""
    assert [item.material for item in read(tmp_path, body).objects] == ["steel", "itu_glass"]


def test_a_cross_section_makes_a_point_target_of_the_whole_subtree(tmp_path: Path) -> None:
    body = f"""def Xform "pedestrian" {{
      custom float radar:rcs_dbsm = -1.5
      {ops(translate={0: (4, 0, 1), 24: (4, 2, 1)})}
      {cube("body")}
    }}
    {cube("wall")}"""
    scene = read(tmp_path, body)
    assert [item.name for item in scene.objects] == ["/wall"]
    (target,) = scene.targets
    assert (target.name, target.rcs_dbsm) == ("/pedestrian", -1.5)
    assert target.position == pytest.approx((4, 0, 1))
    assert target.velocity == pytest.approx((0, 2, 0))
    assert any("1 geometry prims left out" in warning for warning in scene.warnings)


def test_what_is_not_to_be_seen_is_left_out_and_counted(tmp_path: Path) -> None:
    body = f"""def Xform "hidden" {{
      token visibility = "invisible"
      {cube("m")}
    }}
    def Mesh "helper" {{
    {CUBE}
    uniform token purpose = "guide"
    }}
    def BasisCurves "wire" {{
    }}
    def Mesh "seen" {{
    {CUBE.replace('subdivisionScheme = "none"', 'subdivisionScheme = "catmullClark"')}
    }}"""
    scene = read(tmp_path, body)
    assert [item.name for item in scene.objects] == ["/seen"]
    assert set(scene.warnings) == {
        "1 invisible prims skipped, with everything below them",
        "1 prims of purpose guide skipped",
        "1 prims of type BasisCurves ignored",
        "1 subdivision surfaces taken as their control cage",
    }


def test_an_instancer_whose_arrays_disagree_is_named(tmp_path: Path) -> None:
    body = """def PointInstancer "p" {
      int[] protoIndices = [0, 5]
      point3f[] positions = [(0, 0, 0), (1, 1, 1)]
      rel prototypes = </p/c>
      def Cube "c" {
      }
    }"""
    with pytest.raises(InputError, match="point instancer /p: protoIndices run from 0 to 5 with 1 prototypes"):
        read(tmp_path, body)
