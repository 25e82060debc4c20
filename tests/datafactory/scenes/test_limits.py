"""Scenes that ask for more than fits are refused with the part that asks for it; instances are read one by one."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from usd_files import read

from datafactory.scenes.readers import common
from datafactory.scenes.readers.open import open_scene
from shared.physics.errors import InputError

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


def includes(folder: Path, levels: int, count: int) -> Path:
    (folder / "0.xml").write_text('<scene version="2.1.0"><shape type="cube"/></scene>')
    for level in range(1, levels + 1):
        body = f'<include filename="{level - 1}.xml"/>' * count
        (folder / f"{level}.xml").write_text(f'<scene version="2.1.0">{body}</scene>')
    return folder / f"{levels}.xml"


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
    path = includes(tmp_path, 3, 5)
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
