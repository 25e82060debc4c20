"""USD to metres, z up and triangles, on small stages written here; what asks for more than fits is refused."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, area, cube, ops, read, signed_volume, translated

from datafactory.scenes.readers import common
from datafactory.scenes.readers.open import open_scene
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
        custom string radar:class = "window"
        custom double3 radar:velocity = (1, 0, 0)
      }}
    }}"""
    scene = read(tmp_path, body)
    objects = scene.objects
    assert [(item.name, item.material) for item in objects] == [("/m/pane", "glass"), ("/m", "steel")]
    assert [item.velocity[0] for item in objects] == [1.0, 0.0]
    assert [line for line in scene.warnings if "radar:" in line] == [
        "1 attributes radar:class ignored: a mesh may state it, a subset of its faces not"
    ]
    assert [area(item) for item in objects] == pytest.approx([8.0, 16.0])


@pytest.mark.parametrize("specifier", ["def", "over", "class"])
def test_material_subsets_of_a_prototype_split_each_instance(tmp_path: Path, specifier: str) -> None:
    """Prototypes are often overs or classes, so that nothing but the instancer shows them."""
    body = f"""def PointInstancer "cars" {{
      point3f[] positions = [(0, 0, 0), (9, 0, 0)]
      int[] protoIndices = [0, 0]
      rel prototypes = </cars/car>
      {specifier} Mesh "car" {{
        {CUBE}
        {specifier} GeomSubset "pane" {{
          uniform token elementType = "face"
          uniform token familyName = "materialBind"
          int[] indices = [1]
          custom string radar:material = "glass"
        }}
      }}
    }}"""
    assert [(item.name, item.material, area(item)) for item in read(tmp_path, body).objects] == [
        (f"/cars[{number}]/car{part}", material, size)
        for number in (0, 1)
        for part, material, size in (("/pane", "glass", 4.0), ("", "", 20.0))
    ]


@pytest.mark.parametrize(
    "kind", ['elementType = "face"', 'elementType = "point"\nuniform token familyName = "materialBind"']
)
def test_a_subset_that_splits_no_faces_off_is_said_where_it_has_a_material(tmp_path: Path, kind: str) -> None:
    """To USD the family's name makes a subset one that materials are bound by; other programs leave it out."""
    body = f"""def Mesh "m" {{
      {CUBE}
      def GeomSubset "pane" {{
        uniform token {kind}
        int[] indices = [1]
        custom string radar:material = "glass"
      }}
      def GeomSubset "seam" {{
        uniform token {kind.replace("materialBind", "seams")}
        int[] indices = [1]
      }}
    }}"""
    scene = read(tmp_path, body)
    assert [(item.name, item.material, area(item)) for item in scene.objects] == [("/m", "", 24.0)]
    assert scene.warnings == ("1 subsets with a material ignored: they are not of faces in the family materialBind",)


@pytest.mark.parametrize("purpose", [":full", ":preview"])
def test_a_material_of_one_purpose_is_the_material(tmp_path: Path, purpose: str) -> None:
    body = f"""def Material "glass" {{}}
    def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
      {CUBE}
      rel material:binding{purpose} = </glass>
    }}"""
    (item,) = read(tmp_path, body).objects
    assert item.material == "glass"


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


def test_targets_below_a_target_are_counted(tmp_path: Path) -> None:
    body = """def Xform "van" {
      custom float radar:rcs_dbsm = 10
      def Xform "plate" {
        custom float radar:rcs_dbsm = 3
        def Xform "driver" {
          custom string radar:target = "pedestrian"
        }
        def Xform "load" {
          custom string radar:target = "none"
        }
      }
    }"""
    scene = read(tmp_path, body)
    assert [target.name for target in scene.targets] == ["/van"]
    assert scene.warnings == ("2 targets left out: they are below another target, which stands for them",)


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


TRIANGLE = """point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  int[] faceVertexCounts = [3]
  int[] faceVertexIndices = [0, 1, 2]
  uniform token subdivisionScheme = "none"
"""


def nested_instancers(levels: int, count: int) -> str:
    parts = [f'class Xform "P0" {{\n def Mesh "m" {{\n{TRIANGLE}}}\n}}']
    for level in range(1, levels + 1):
        kind = "def" if level == levels else "class"
        positions = ", ".join(f"({100 * index}, {level}, 0)" for index in range(count))
        parts.append(
            f'{kind} PointInstancer "P{level}" {{\n rel prototypes = </P{level - 1}>\n'
            f" int[] protoIndices = [{', '.join('0' * count)}]\n point3f[] positions = [{positions}]\n}}"
        )
    return "\n".join(parts)


def nested_references(levels: int, count: int, metadata: str) -> str:
    parts = [f'class Xform "L0" {{\n def Mesh "m" {{\n{TRIANGLE}}}\n}}']
    for level in range(1, levels + 1):
        kind = "def" if level == levels else "class"
        children = [f'def "c{i}" ({metadata}\n references = </L{level - 1}>) {{\n}}' for i in range(count)]
        parts.append(f'{kind} Xform "L{level}" {{\n' + "\n".join(children) + "\n}")
    return "\n".join(parts)


def test_an_instancer_is_refused_by_what_its_first_instance_makes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(read(tmp_path, nested_instancers(3, 5)).objects) == 125
    monkeypatch.setattr(common, "MAXIMUM_OBJECTS", 100)
    with pytest.raises(InputError, match="point instancer /P3 makes 125 objects; expected at most 100"):
        read(tmp_path, nested_instancers(3, 5))
    monkeypatch.setattr(common, "MAXIMUM_TRIANGLES", 20)
    with pytest.raises(InputError, match="point instancer /P2 makes 25 triangles; expected at most 20"):
        read(tmp_path, nested_instancers(3, 5))
    with pytest.raises(InputError, match=r"/P36 lies within 64 levels of instances"):
        read(tmp_path, nested_instancers(100, 1))


@pytest.mark.parametrize("metadata", ["", "instanceable = true"])
def test_references_are_refused_where_there_is_one_object_too_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metadata: str
) -> None:
    assert len(read(tmp_path, nested_references(3, 5, metadata)).objects) == 125
    monkeypatch.setattr(common, "MAXIMUM_OBJECTS", 100)
    with pytest.raises(InputError, match="as far as /L3/c4/c0/c0/m makes 101 objects; expected at most 100"):
        read(tmp_path, nested_references(3, 5, metadata))


def test_shapes_of_a_mitsuba_file_are_refused_likewise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.xml"
    cubes = '<shape type="cube"/>' * 125
    path.write_text(f'<scene version="2.1.0">{cubes}</scene>')
    assert len(open_scene(str(path)).objects) == 125
    monkeypatch.setattr(common, "MAXIMUM_TRIANGLES", 1200)
    with pytest.raises(InputError, match="as far as shape 'shape-101' makes 1212 triangles; expected at most 1200"):
        open_scene(str(path))


def test_xml_that_grows_is_refused(tmp_path: Path) -> None:
    """Sixty parameters of two parameters each would fill the memory."""
    grown = "".join(f'<default name="a{i}" value="$a{i - 1}$a{i - 1}"/>' for i in range(1, 60))
    (tmp_path / "scene.xml").write_text(f'<scene version="2.1.0"><default name="a0" value="xx"/>{grown}</scene>')
    with pytest.raises(InputError, match=r"has 131072 characters; expected at most 100000"):
        open_scene(str(tmp_path / "scene.xml"))


def gltf(count: int, nodes: int) -> str:
    """A glTF document of one triangle, its accessor said to have ``count`` elements, placed by ``nodes`` nodes."""
    data = base64.b64encode(np.eye(3, dtype=np.float32).tobytes()).decode()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0, "translation": [index, 0, 0]} for index in range(nodes)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": f"data:application/octet-stream;base64,{data}"}],
    }
    return json.dumps(document)


def test_a_gltf_that_asks_for_a_huge_array_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "huge.gltf"
    path.write_text(gltf(10**12, 1))
    with pytest.raises(InputError, match="an accessor of 1000000000000 elements; expected at most 60000000"):
        open_scene(str(path))


def test_the_nodes_of_a_gltf_are_one_mesh_in_several_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "shared.gltf"
    path.write_text(gltf(3, 2))
    one, other = open_scene(str(path)).objects
    assert one.material == ""
    np.testing.assert_array_equal(np.abs(one.vertices - other.vertices).max(axis=0), [1.0, 0.0, 0.0])
    monkeypatch.setattr(common, "MAXIMUM_OBJECTS", 1)
    with pytest.raises(InputError, match="the scene makes 2 objects; expected at most 1"):
        open_scene(str(path))


def test_instances_whose_triangles_are_dropped_are_counted_one_by_one(tmp_path: Path) -> None:
    body = f"""def PointInstancer "p" {{
      rel prototypes = </t>
      int[] protoIndices = [0, 0, 0]
      point3f[] positions = [(0, 0, 0), (5, 0, 0), (9, 0, 0)]
      float3[] scales = [(1, 1, 1), (0, 1, 1), (1, 1, 1)]
    }}
    class Mesh "t" {{
    {TRIANGLE} }}"""
    scene = read(tmp_path, body)
    assert [item.name for item in scene.objects] == ["/p[0]/t", "/p[2]/t"]
    assert "1 triangles without area dropped" in scene.warnings
    assert "1 meshes or subsets without a usable triangle ignored" in scene.warnings
