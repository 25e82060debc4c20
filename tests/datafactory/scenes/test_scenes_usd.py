"""USD to metres, z up and triangles, on small stages written here; what asks for more than fits is refused.

What is wrong in a file or an option is one line: the source, the field, its value and what would be right.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from usd_files import CUBE, METRES_Z_UP, area, cube, ops, read, signed_volume, translated

from datafactory.frame.points import read_targets
from datafactory.scenes.drives import parse_drives
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.scenes.readers import common
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.tracks import read_track
from datafactory.scenes.traffic.arrange import parse_populate
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


READERS: dict[str, Callable[[Path], object]] = {
    "poses.json": read_poses, "track.json": read_track, "track.csv": read_track, "targets.json": read_targets,
    "materials.toml": load_materials, "prim.usda": lambda path: open_scene(str(path)),
    "metadata.usda": lambda path: open_scene(str(path)), "scene.xml": lambda path: open_scene(str(path)),
}  # fmt: skip
ROWS = "time,x,y,z,yaw_deg\n0,0,0,0.5,0\n1,4,0,0.5,0\n2,8,0,0.5,90\n4,8,8,0.5,90\n"
HERE, NAMES = '"position": [0, 0, 1]', "time,x,y,z,yaw_deg"
FLAT = "\nfloat3 xformOp:scale = (1, 1, 0)\nuniform token[] xformOpOrder = ['xformOp:scale']"
JUMP = (
    "\ndouble xformOp:translateX.timeSamples = { 0: 0, 1: nan }\nuniform token[] xformOpOrder = ['xformOp:translateX']"
)

FILES: dict[str, list[tuple[str | bytes, str]]] = {
    "poses.json": [
        ("[{", "malformed JSON"),
        ("{}", r"document = \{\}; expected input should be a valid list, as in \[\{"),
        ("[]", "the list is empty; expected "),
        ("[{}]", r"entry 0\.position missing; expected field required, as in \[\{.position"),
        (f'[{{{HERE}}}, {{"position": [0, 0]}}]', r"entry 1\.position = \[0, 0\]; expected list should have"),
        ('[{"position": [0, 0, NaN]}]', r"entry 0\.position\.2 = nan; expected input should be a finite number"),
        (f'[{{{HERE}, "yaw": 3}}]', r"unknown field entry 0\.yaw; expected one of position, yaw_deg"),
        (f"[{{{HERE}, {HERE}}}]", "the key 'position' is given twice"),
    ],
    "track.json": [  # beyond what is wrong in a list of poses
        (f"[{{{HERE}}}]", r"entry 0\.time missing; expected field required, as in \[\{"),
        (f'[{{"time": 0, {HERE}}}, {{"time": 0, {HERE}}}]', "entry 1, time = 0 after 0"),
        (f'[{{"time": 0, {HERE}, "velocity": [1, 0, 0]}}, {{"time": 1, {HERE}}}]', "entry 1 has no velocity, others"),
    ],
    "track.csv": [
        ("", r"is empty; expected a line of names, time,x,y,z,yaw_deg\[,pitch_deg\]"),
        ("time,x,y,z\n0,0,0,0\n", "line 1: no column 'yaw_deg'"),
        (f"{NAMES},speed\n", "line 1: column 'speed' unknown; expected some of time, x"),
        ("time,x,x,y,z,yaw_deg\n", "line 1: column 'x' twice"),
        (f"{NAMES},vx\n", "line 1: no column 'vy'"),
        (f"{NAMES}\n0,0,0,0,0\n", "1 pose; expected at least two"),
        (ROWS + "5,1,2,3\n", "line 6 has 4 values; expected 5"),
        (ROWS + "5,a,2,3,4\n", "line 6, x = 'a'; expected input should be a valid number"),
        (ROWS + "5,1,2,nan,4\n", "line 6, z = 'nan'; expected input should be a finite number"),
        (ROWS + "5,1e10,2,3,4\n", "line 6, x = '1e10'; expected input should be less than or equal to"),
        (ROWS + "4,1,2,3,4\n", "line 6, time = 4 after 4; expected times that rise"),
        (ROWS + "4.000001,9,8,0.5,4\n", r"line 6 is reached at 1e\+06 m/s from the pose before; expected at most"),
        (ROWS + '5,"1,2,3,4\n', "is no table"),
        (b"\xff\xfe\x00t", "is no table"),
    ],
    "targets.json": [
        ('[[{"x": 1.0, "y": 0.0}]]', "no rcs_dbsm; expected one, or a model"),
        ('[[{"x": 1.0, "y": 0.0, "model": "car", "rcs_dbsm": 1.0}]]', "a model beside rcs_dbsm"),
        ('[[{"x": 1.0, "y": 0.0, "rcs_dbsm": 1.0, "stature_m": 1.7}]]', "stature_m without a model"),
        ('[[{"x": 1.0, "y": 0.0, "model": "pedestrian", "stature_m": "tall"}]]', "tall"),
        ('[[{"x": 1, "y": 0, "model": "pedestrian", "stature_m": 1.7, "vx": 9}]]', "a walker of 1.7 m at 9 m/s"),
        ('[[{"x": 1.0, "y": 0.0, "model": "car", "sizes": {"wheel_radius_m": 0.3}}]]', "sizes"),
    ],
    "materials.toml": [
        ("[material.brick\n", "malformed TOML"),
        (b"\xff\xfe", "not UTF-8 text"),
        ("[materials.brick]\n", "unknown field materials; expected one of material, map, default"),
        ("[material.brick]\nconductance = 1.0", r"unknown field material\.brick\.conductance; expected one of"),
        ("[material.brick]\nrelative_permittivity = 0.5", r"brick\.relative_permittivity = 0\.5; expected input"),
        ("[material.brick]\nsigma0_db = -20.0", "no roughness; expected scattering_coefficient, or sigma0_db with"),
        ("[material.brick]\nvalid_ghz = [90.0, 80.0]", r"valid_ghz = \[90\.0, 80\.0\]; expected"),
        ("[material.brick]\naliases = ['42']", "alias '42' has no letters"),
        ("[material.foam]\nconductivity = 1.0", r"material\.foam\.relative_permittivity missing; expected field"),
        ("[map]\nwall = 'jelly'", r"map\.wall = 'jelly'; expected one of concrete, brick"),
    ],
    "prim.usda": [
        ("string radar:rcs_dbsm = 'ten'", r"/t\.radar:rcs_dbsm = 'ten'; expected a finite number"),
        ("float radar:velocity = 3", r"/t\.radar:velocity = 3\.0; expected three finite numbers"),
        ("double3 radar:velocity = (inf, 0, 0)", r"/t\.radar:velocity = .*; expected three finite numbers"),
        ("float radar:material = 3", r"/t\.radar:material = 3\.0; expected a material name"),
        ("string radar:class = ''", r"/t\.radar:class = ''; expected the name of a class"),
        ("string radar:target = 'lorry'", r"/t\.radar:target = 'lorry'; expected one of car"),
        ("string radar:target = 'car'; float radar:rcs_dbsm = 3", "one of the two"),
        ("float radar:targets_by_name = 1", r"/t\.radar:targets_by_name = 1\.0; expected true or false"),
        (f"string radar:target = 'car'{FLAT}", "its transform is flat"),
        ("string radar:target = 'sphere'", "'sphere' with no sizes; expected radius_m"),
        ("string radar:target = 'sphere'; string radar:radius_m = 'big'", r"/t\.radar:radius_m = 'big'; expected a"),
        ("string radar:target = 'car'; float radar:radius_m = 1", "'car' with radius_m; expected no sizes"),
        ("string radar:target = 'trihedral'; float radar:edge_m = 0", r"edge_m = 0\.0; expected more than 0"),
        ("string radar:target = 'car'; bool radar:wheel_radius_m = 1", "radar:wheel_radius_m = True"),
        ("string radar:target = 'car'; float radar:wheel_radius_m = 3", r"wheel_radius_m = 3\.0; expected 0\.1 to 1"),
        ("string radar:target = 'pedestrian'; double radar:gait_phase = 1.5", r"gait_phase = 1\.5; expected 0 to 1"),
        (
            "string radar:target = 'pedestrian'; float radar:stature_m = 1.7; double3 radar:velocity = (3, 0, 0)",
            r"/t: a walker of 1\.7 m at 3 m/s; expected at most 2\.5 m/s",
        ),
        (f"string radar:class = 'car'{JUMP}", r"/t/m moves at \(nan, nan, nan\) m/s; expected at most"),
    ],
    "metadata.usda": [
        ("metersPerUnit = 0", "metersPerUnit = 0"),
        ('upAxis = "W"', "upAxis = 'W'; expected X, Y or Z"),
        ("timeCodesPerSecond = 0", "timeCodesPerSecond = 0"),
        ("startTimeCode = nan", "startTimeCode = nan"),
        ("subLayers = [@gone.usda@]", r"gone\.usda"),
    ],
    "scene.xml": [
        ('<shape type="ply" id="a"><string name="filename" value="gone.ply"/></shape>', "shape 'a': mesh file .*gone"),
        ('<shape type="ply" id="a"><string name="filename" value="torn.ply"/></shape>', "torn.ply.* cannot be read"),
        ('<shape type="ply" id="a"/>', "shape 'a': no filename"),
        ('<shape type="cube" id="a"><ref id="mat-gone"/></shape>', "mat-gone"),
        ('<shape type="cube" id="a"/><shape type="cube" id="a"/>', "id 'a' is used twice"),
        ('<shape type="sphere" id="a"><float name="radius" value="-1"/></shape>', "radius = -1; expected a positive"),
        ('<shape type="sphere" id="a"><string name="radius" value="x"/></shape>', "radius = 'x' is a <string>"),
        ('<shape type="cube" id="a"><string name="to_world" value="x"/></shape>', "to_world = 'x'"),
        ('<shape type="cube"><transform name="to_world"><scale x="nan"/></transform></shape>', "to_world has <scale x"),
        ('<shape type="cube"><transform name="to_world"><twist x="1"/></transform></shape>', "to_world has <twist x"),
        ('<shape type="cube"', "not well-formed XML"),
        ('<include filename="scene.xml"/>', "nested more than 15 deep"),
        ('<shape type="ply"><string name="filename" value="$name"/></shape>', "undefined parameter"),
    ],
}  # fmt: skip


def content(name: str, text: str) -> str:
    """A whole file of what is wrong in it."""
    if name == "prim.usda":
        attributes = f"custom {text}".replace("; ", "\ncustom ")
        body = f'def Xform "t" {{\n{attributes}\ndef Mesh "m" {{\n{CUBE}\n}}\n}}'
        return f"#usda 1.0\n(\n{METRES_Z_UP}\n timeCodesPerSecond = 1\n)\n{body}\n"
    if name == "metadata.usda":
        return f'#usda 1.0\n(\n{text}\n)\ndef Cube "c" {{\n}}\n'
    return f'<scene version="2.1.0">{text}</scene>' if name == "scene.xml" else text


@pytest.mark.parametrize(("name", "text", "message"), [(name, *row) for name, rows in FILES.items() for row in rows])
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    (tmp_path / "torn.ply").write_bytes(trimesh.creation.box().export(file_type="ply")[:300])
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else content(name, text).encode())
    with pytest.raises(InputError, match=message) as caught:
        READERS[name](path)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["poses.json", "track.csv", "materials.toml"])
def test_a_file_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: cannot be read: No such file"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (parse_drives, "walk", r"--trajectory: 'walk'; expected a file, or drive\[:speed=M/S\]\[,seconds=S\]"),
        (parse_drives, "drive:sped=3", r"'sped=3' in 'drive:sped=3'"),
        (parse_drives, "drive:speed=3,speed=4", r"'speed=4' in"),
        (parse_drives, "drive:speed=fast", r"speed = 'fast'; expected a number"),
        (parse_drives, "drive:speed=16", r"speed = 16.0; expected 0 to 15 m/s"),
        (parse_drives, "drive:seconds=0", r"seconds = 0.0; expected more than 0"),
        (parse_drives, "drive:seconds=0.01", r"0.01 s at 10 Hz are 0 frames"),
        (parse_populate, "cras=3", r"unknown kind 'cras'; expected one of cars, trucks.*did you mean 'cars'\?"),
        (parse_populate, "cars=-3", "cars=-3; expected a whole number from 0 to 2000"),
        (parse_populate, "cars=many/100m", "cars=many/100m; expected from 0 to 100 a hundred metres of road"),
        (parse_populate, "cars=1,cars=2/100m", "cars is given twice"),
        (parse_populate, "parked=0.4/100m", r"parked=0\.4/100m; expected a share"),
        (parse_populate, "cars=2.5", r"cars=2\.5; expected a whole number"),
        (parse_populate, "cars", "cars without a number"),
        (parse_populate, "parked=1.5", r"parked=1\.5; expected a share of the kerb from 0 to 1"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(parse: Callable[..., object], text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse(text, None) if parse is parse_drives else parse(text)
    assert "\n" not in str(caught.value)
