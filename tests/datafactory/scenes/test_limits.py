"""Scenes that ask for more than fits are refused with the figure, before expansion; instances share their mesh."""

from __future__ import annotations

import base64
import json
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, read, write_usda

from datafactory.scenes.chain import placed
from datafactory.scenes.readers.limits import MAXIMUM_OBJECTS, figure
from datafactory.scenes.readers.local_mesh import LocalMesh
from datafactory.scenes.readers.meshes import usable
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import SceneObject
from shared.physics.errors import InputError

TRIANGLE = """point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  int[] faceVertexCounts = [3]
  int[] faceVertexIndices = [0, 1, 2]
  uniform token subdivisionScheme = "none"
"""


@contextmanager
def at_once() -> Iterator[None]:
    """A refusal takes no longer than opening a small file; the bound leaves room for a busy machine."""
    started = time.perf_counter()
    yield
    assert time.perf_counter() - started < 10.0


def nested_instancers(levels: int, count: int) -> str:
    parts = [f'class Xform "P0" {{\n def Mesh "m" {{\n{TRIANGLE}}}\n}}']
    for level in range(1, levels + 1):
        kind = "def" if level == levels else "class"
        positions = ", ".join(f"({100**level * index}, 0, 0)" for index in range(count))
        parts.append(
            f'{kind} PointInstancer "P{level}" {{\n rel prototypes = </P{level - 1}>\n'
            f" int[] protoIndices = [{', '.join('0' * count)}]\n point3f[] positions = [{positions}]\n}}"
        )
    return "\n".join(parts)


def nested_references(levels: int, count: int, metadata: str = "") -> str:
    parts = [f'class Xform "L0" {{\n def Mesh "m" {{\n{TRIANGLE}}}\n}}']
    for level in range(1, levels + 1):
        kind = "def" if level == levels else "class"
        children = [f'def "c{i}" ({metadata}\n references = </L{level - 1}>) {{\n}}' for i in range(count)]
        parts.append(f'{kind} Xform "L{level}" {{\n' + "\n".join(children) + "\n}")
    return "\n".join(parts)


def test_nested_point_instancers_are_refused_with_the_figure(tmp_path: Path) -> None:
    expected = "point instancer /P4 makes 6250000 objects; expected at most 250000"
    with at_once(), pytest.raises(InputError, match=expected):
        read(tmp_path, nested_instancers(4, 50))
    with at_once(), pytest.raises(InputError, match=r"makes \d+ objects; expected at most 250000"):
        read(tmp_path, nested_instancers(60, 2))
    with (
        at_once(),
        pytest.raises(InputError, match=r"/P\d+ lies within 64 levels of instances; expected fewer than 64"),
    ):
        read(tmp_path, nested_instancers(100, 1))
    assert len(read(tmp_path, nested_instancers(2, 30)).objects) == 900


@pytest.mark.parametrize("metadata", ["", "instanceable = true"])
def test_nested_references_are_refused_before_usd_composes_them(tmp_path: Path, metadata: str) -> None:
    # 2 prims, then 1 + 50 times as many at each level.
    with at_once(), pytest.raises(InputError, match="prim /L4 composes 12627551 prims; expected at most 1000000"):
        read(tmp_path, nested_references(4, 50, metadata))
    with at_once(), pytest.raises(InputError, match=r"composes \d+ prims"):
        read(tmp_path, nested_references(100, 2, metadata))
    assert len(read(tmp_path, nested_references(2, 20, metadata)).objects) == 400


def test_references_across_files_are_counted_too(tmp_path: Path) -> None:
    write_usda(tmp_path, f'def Mesh "x" {{\n{TRIANGLE}}}', name="0.usda")
    for level in range(1, 5):
        arc = ("references", "payload")[level % 2]
        children = "\n".join(f'def "c{i}" ({arc} = @{level - 1}.usda@</x>) {{\n}}' for i in range(50))
        write_usda(tmp_path, f'def Xform "x" {{\n{children}\n}}', name=f"{level}.usda")
    with at_once(), pytest.raises(InputError, match=r"composes \d{7} prims"):
        open_scene(str(tmp_path / "4.usda"))


def test_many_triangles_are_refused_before_they_are_placed(tmp_path: Path) -> None:
    body = f"""class Sphere "ball" {{
    }}
    def PointInstancer "balls" {{
      rel prototypes = </ball>
      int[] protoIndices = [{", ".join("0" * 10_000)}]
      point3f[] positions = [{", ".join("(0, 0, 0)" for _ in range(10_000))}]
    }}"""
    with at_once(), pytest.raises(InputError, match=r"/balls makes 39680000 triangles; expected at most 20000000"):
        read(tmp_path, body)
    (tmp_path / "many.xml").write_text('<scene version="2.1.0">' + '<shape type="sphere"/>' * 10_000 + "</scene>")
    with at_once(), pytest.raises(InputError, match="the scene makes 39680000 triangles; expected at most 20000000"):
        open_scene(str(tmp_path / "many.xml"))


def test_hidden_prims_do_not_count(tmp_path: Path) -> None:
    hidden = nested_instancers(4, 50).replace('def PointInstancer "P4" {', 'def PointInstancer "P4" {\n token {}\n')
    for attribute in ('visibility = "invisible"', 'purpose = "guide"'):
        prefix = "" if attribute.startswith("vis") else "uniform "
        body = hidden.replace(" token {}", f" {prefix}token {attribute}")
        assert len(read(tmp_path, f'{body}\ndef Mesh "m" {{\n{CUBE}\n}}').objects) == 1


def test_nested_includes_are_counted_before_they_are_read_again(tmp_path: Path) -> None:
    (tmp_path / "0.xml").write_text('<scene version="2.1.0"><shape type="cube"/></scene>')
    for level in range(1, 5):
        includes = f'<include filename="{level - 1}.xml"/>' * 50
        (tmp_path / f"{level}.xml").write_text(f'<scene version="2.1.0">{includes}</scene>')
    with (
        at_once(),
        pytest.raises(InputError, match="has 6250000 objects with those of its includes; expected at most 25"),
    ):
        open_scene(str(tmp_path / "4.xml"))
    assert len(open_scene(str(tmp_path / "2.xml")).objects) == 2500


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            '<default name="a0" value="xx"/>'
            + "".join(f'<default name="a{i}" value="$a{i - 1}$a{i - 1}"/>' for i in range(1, 60)),
            r"\$a15 makes a value of 131080 characters; expected at most 100000",
        ),
        ("<a>" * 100_000 + "</a>" * 100_000, "more than 64 elements within one another"),
        ('<include filename="scene.xml"/>' * 2, "<include> is nested more than 15 deep"),
    ],
)
def test_xml_that_grows_is_refused(tmp_path: Path, body: str, message: str) -> None:
    (tmp_path / "scene.xml").write_text(f'<scene version="2.1.0">{body}<shape type="cube"/></scene>')
    with at_once(), pytest.raises(InputError, match=message):
        open_scene(str(tmp_path / "scene.xml"))


def gltf(count: int, nodes: int) -> dict[str, object]:
    """A glTF document of one triangle, its accessor said to have ``count`` elements, placed by ``nodes`` nodes."""
    data = base64.b64encode(np.eye(3, dtype=np.float32).tobytes()).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0, "translation": [index, 0, 0]} for index in range(nodes)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": f"data:application/octet-stream;base64,{data}"}],
    }


def test_a_gltf_that_asks_for_a_huge_array_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "huge.gltf"
    path.write_text(json.dumps(gltf(10**12, 1)))
    with at_once(), pytest.raises(InputError, match="an accessor of 1000000000000 elements; expected at most 60000000"):
        open_scene(str(path))


def test_the_nodes_of_a_gltf_share_their_mesh(tmp_path: Path) -> None:
    path = tmp_path / "shared.gltf"
    path.write_text(json.dumps(gltf(3, 2)))
    one, other = open_scene(str(path)).objects
    assert one.triangles is other.triangles
    assert one.material == ""
    np.testing.assert_array_equal(np.abs(one.vertices - other.vertices).max(axis=0), [1.0, 0.0, 0.0])


@pytest.mark.parametrize("mirrored", [False, True])
def test_shared_meshes_have_the_vertices_of_copies_bit_for_bit(generator: np.random.Generator, mirrored: bool) -> None:
    points = generator.standard_normal((40, 3)).astype(np.float32)
    triangles = generator.permutation(36).reshape(12, 3).astype(np.int64)
    shared, copy = LocalMesh(points, triangles, shared=True), LocalMesh(points, triangles)
    matrix = np.eye(4)
    for _ in range(20):
        matrix[:3] = generator.standard_normal((3, 4)) * 10.0 ** generator.uniform(-3, 3)
        matrix[0, :3] *= np.sign(np.linalg.det(matrix[:3, :3])) * (-1 if mirrored else 1)
        one, other = (SceneObject.of("x", *mesh.placed(matrix)[:2]) for mesh in (shared, copy))
        assert one.vertices.tobytes() == other.vertices.tobytes()
        assert one.triangles.tobytes() == other.triangles.tobytes()
        assert one.triangles.dtype == other.triangles.dtype


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


def test_instances_take_the_memory_of_one_mesh_and_of_their_places(tmp_path: Path) -> None:
    size, count = 30, 1000
    grid = [(x, y, 0.01 * x * y) for x in range(size) for y in range(size)]
    faces = [(a, a + size, a + size + 1, a + 1) for x in range(size - 1) for a in range(x * size, x * size + size - 1)]
    body = f"""class Mesh "sheet" {{
      point3f[] points = [{", ".join(map(str, grid))}]
      int[] faceVertexCounts = [{", ".join("4" * len(faces))}]
      int[] faceVertexIndices = [{", ".join(str(corner) for face in faces for corner in face)}]
      uniform token subdivisionScheme = "none"
    }}
    def PointInstancer "sheets" {{
      rel prototypes = </sheet>
      int[] protoIndices = [{", ".join("0" * count)}]
      point3f[] positions = [{", ".join(f"({index}, 0, 0)" for index in range(count))}]
    }}"""
    write_usda(tmp_path, body, METRES_Z_UP)
    tracemalloc.start()
    scene = open_scene(str(tmp_path / "stage.usda"))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(scene.objects) == count
    # Copies would be 900 vertices of 24 bytes and 1682 triangles of 12 bytes each, 42 MB.
    assert held < 4e6
    np.testing.assert_array_equal(scene.objects[999].vertices.min(axis=0), [999.0, 0.0, 0.0])


def test_a_count_is_written_in_digits_until_it_is_too_long() -> None:
    assert figure(MAXIMUM_OBJECTS) == "250000"
    assert figure(50**12) == "2.4e+20"
    assert figure(10**400) == "1.0e+300"


def test_whether_all_triangles_are_usable_is_what_placing_them_says() -> None:
    """Over random transforms, many of them nearly or wholly flat, huge, or no numbers."""
    random = np.random.default_rng(7)
    triangles = random.permuted(np.tile(np.arange(9), (20, 1)), axis=1)[:, :3]
    mesh = LocalMesh(random.normal(size=(9, 3)).astype(np.float32), triangles, shared=True)
    answers = set()
    for scale in (1.0, 1e-3, 1e-6, 1e-7, 0.0, 1e8, 1e9, np.inf, np.nan):
        for _ in range(20):
            matrix = np.eye(4)
            turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
            with np.errstate(invalid="ignore"):
                matrix[:3, :3] = turn @ np.diag([1.0, 1.0, scale]) @ np.linalg.qr(random.normal(size=(3, 3)))[0]
            matrix[:3, 3] = random.normal(size=3) * 10.0 ** random.uniform(-3.0, 10.0)
            with np.errstate(invalid="ignore", over="ignore"):
                slow = bool(usable(placed(mesh.points, matrix)[mesh.triangles]).all())
            assert mesh._all_usable(matrix) == slow
            answers.add(slow)
    assert answers == {True, False}
