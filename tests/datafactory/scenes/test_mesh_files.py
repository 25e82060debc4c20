"""OBJ, PLY and glTF files as other programs write them: polygons, indices, materials, and what is not read."""

import base64
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from usd_files import area

from datafactory.scenes.readers.mitsuba import read_mitsuba
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

YARD = [(0, 0), (6, 0), (6, 6), (4, 6), (4, 2), (2, 2), (2, 6), (0, 6)]
"""The outline of a house around a yard, 28 m2; a fan covers the yard too."""
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def opened(path: Path, content: str | bytes) -> Scene:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return open_scene(str(path))


def covered(scene: Scene) -> float:
    return sum(area(item) for item in scene.objects)


def obj_outline(outline: list[tuple[int, int]]) -> str:
    corners = " ".join(f"{number}/1" for number in range(1, len(outline) + 1))
    return "vt 0 0\n" + "".join(f"v {x} {y} 0\n" for x, y in outline) + f"f {corners}\n"


@pytest.mark.parametrize(("outline", "size"), [(YARD, 28.0), ([(0, 0), (4, 0), (1, 1), (0, 4)], 4.0)])
def test_a_concave_face_of_an_obj_file_covers_its_outline_alone(
    tmp_path: Path, outline: list[tuple[int, int]], size: float
) -> None:
    for shift in range(len(outline)):
        turned = outline[shift:] + outline[:shift]
        scene = opened(tmp_path / "m.obj", obj_outline(turned))
        assert covered(scene) == pytest.approx(size)
        corners = scene.objects[0].vertices[scene.objects[0].triangles]
        assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def test_concave_faces_that_a_mitsuba_file_refers_to_are_cut_alike(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(obj_outline(YARD))
    shape = '<shape type="obj" id="m"><string name="filename" value="m.obj"/></shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    assert covered(read_mitsuba(tmp_path / "scene.xml")) == pytest.approx(28.0)


def test_convex_faces_stay_as_they_were_beside_concave_ones(tmp_path: Path) -> None:
    """Names and order, on which a scene's hash depends."""
    square = "mtllib m.mtl\ns off\no a\n" + SQUARE + "f 1 2 3 4\n"
    (plain,), (rewritten,) = (opened(tmp_path / "m.obj", square + more).objects for more in ("", "# 1\n # 2\n"))
    assert (plain.name, plain.triangles.tolist()) == (rewritten.name, rewritten.triangles.tolist())


def test_a_face_that_crosses_itself_is_told(tmp_path: Path) -> None:
    scene = opened(tmp_path / "m.obj", obj_outline([(0, 0), (2, 0), (0, 2), (2, 2), (1, 3)]))
    assert "1 faces whose outline crosses itself cut into a fan" in scene.warnings


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3\nf 1 3 4",
        "f -4 -3 -2\nf -4 -2 -1",
        "f\t1 2 3\n  f 1 3 4",
        "f 1 2 3 # the first\nf 1 3 4# and the second",
        "f 1 2 \\\n3\nf 1\\\r\n 3 4",
        "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf -4//-1 -2//-1 -1//-1",
        "#usemtl brick\nf 1 2 3 4",
    ],
)
def test_obj_statements_are_read_as_the_format_has_them(tmp_path: Path, faces: str) -> None:
    later = "v 9 9 9\nv 8 8 8\nv 8 9 9\nv 9 8 8\n"
    (item,) = opened(tmp_path / "m.obj", f"{SQUARE}{faces}\n{later}").objects
    np.testing.assert_array_equal(item.vertices, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    np.testing.assert_array_equal(item.triangles[0], [0, 1, 2])
    assert (area(item), item.material) == (1.0, "")


def test_indented_vertices_count(tmp_path: Path) -> None:
    (item,) = opened(tmp_path / "m.obj", "  v 0 0 0 # here\n\tv 1 0 0\nv\t1 1 0\nf 1 2 3\n").objects
    assert area(item) == 0.5


@pytest.mark.parametrize("index", ["-5", "5"])
def test_an_index_that_leads_nowhere_is_refused_in_one_line(tmp_path: Path, index: str) -> None:
    with pytest.raises(InputError, match=r"m\.obj.* cannot be read") as caught:
        opened(tmp_path / "m.obj", f"{SQUARE}f 1 2 {index}\n")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mtl", [None, "newmtl brick\nKd 1 0 0\n"])
@pytest.mark.parametrize("first", ["", "mtllib m.mtl\n"])
def test_a_material_keeps_its_name_without_an_entry_in_an_mtl_file(tmp_path: Path, first: str, mtl: str | None) -> None:
    if mtl is not None:
        (tmp_path / "m.mtl").write_text(mtl)
    body = f"{first}{SQUARE}usemtl brick\nf 1 2 3\nusemtl glass # of the shop\nf 1 3 4\n"
    assert {item.material for item in opened(tmp_path / "m.obj", body).objects} == {"brick", "glass"}


def ply(
    vertices: Sequence[tuple[float, ...]], faces: Sequence[list[int]], order: str = "<", number: str = "float"
) -> bytes:
    """A PLY file: text where the byte order is "", else binary."""
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    axes = "".join(f"property {number} {axis}\n" for axis in "xyz")
    header = f"""ply\nformat {form} 1.0\nelement vertex {len(vertices)}\n{axes}element face {len(faces)}
property uchar red\nproperty list uchar int vertex_indices\nend_header\n"""
    if not order:
        rows = [*vertices, *([255, len(face), *face] for face in faces)]
        return (header + "\n".join(" ".join(str(value) for value in row) for row in rows) + "\n").encode()
    points = np.array(vertices, order + ("f4" if number == "float" else "f8")).tobytes()
    return header.encode() + points + b"".join(struct.pack(f"{order}BB{len(f)}i", 255, len(f), *f) for f in faces)


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_a_concave_face_of_a_ply_file_covers_its_outline_alone(tmp_path: Path, order: str) -> None:
    faces = [[*range(8)], [*reversed(range(8))], [0, 1, 2, 9]]
    data = ply([(x, y, 0.1) for x, y in YARD], faces, order)
    scene = opened(tmp_path / "m.ply", data)
    (item,) = scene.objects
    assert (item.name, covered(scene)) == ("m.ply", pytest.approx(2 * 28.0))
    assert np.unique(item.vertices[:, 2]) == np.float32(0.1)
    assert "1 faces with fewer than three corners or an index out of range dropped" in scene.warnings


@pytest.mark.parametrize("number", ["float", "double"])
@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("sizes", [(3, 4, 5), (4, 3, 5), (5, 5, 4)])  # the second is as long as three of four corners
def test_a_ply_file_of_faces_of_different_sizes_is_read(
    tmp_path: Path, sizes: tuple[int, ...], order: str, number: str
) -> None:
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (-0.1, 0.5, 0)]
    scene = opened(tmp_path / "m.ply", ply(corners, [[*range(size)] for size in sizes], order, number))
    assert covered(scene) == pytest.approx(sum({3: 0.5, 4: 1.0, 5: 1.05}[size] for size in sizes))
    assert scene.objects[0].vertices[:, 0].min() == (np.float32(-0.1) if number == "float" else -0.1)


def test_a_torn_ply_file_of_faces_of_different_sizes_is_refused(tmp_path: Path) -> None:
    whole = ply([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [[0, 1, 2], [0, 1, 2, 3]])
    for torn in (whole[:-1], whole + b"x", whole[:-17] + b"\xff" + whole[-16:]):
        with pytest.raises(InputError, match=r"m\.ply.* cannot be read"):
            opened(tmp_path / "m.ply", torn)


def gltf(folder: Path, primitives: list[dict[str, Any]], **more: Any) -> Scene:
    """A square of two triangles as accessors 0 (corners) and 1 (indices); 2 are the corners, the last one moved."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], "<f4").tobytes()
    data = corners + np.array([0, 1, 2, 2, 1, 3, 3, 0], "<u2").tobytes() + np.array([(5, 5, 0)], "<f4").tobytes()
    place = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
    moved = {"count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    header = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": length}
            for start, length in ((0, 48), (48, 12), (58, 2), (64, 12))
        ],
        "accessors": [
            place, {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}, {**place, "sparse": moved}
        ],
        "meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0, **more,
    }  # fmt: skip
    return opened(folder / "m.gltf", json.dumps(header))


SHEET = {"attributes": {"POSITION": 0}, "indices": 1}


def test_gltf_corners_in_a_sparse_accessor_are_refused_and_others_are_not(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"accessor 2 of a mesh is sparse; expected a file exported without"):
        gltf(tmp_path, [{**SHEET, "attributes": {"POSITION": 2}}])
    assert gltf(tmp_path, [{**SHEET, "targets": [{"POSITION": 2}]}]).warnings == ()


def test_gltf_primitives_that_are_left_out_are_counted(tmp_path: Path) -> None:
    fan, strip, line = ({"attributes": {"POSITION": 0}, "mode": mode} for mode in (6, 5, 3))
    scene = gltf(tmp_path, [SHEET, fan, strip, line, fan])
    assert scene.warnings == ("1 glTF line strips ignored", "2 glTF triangle fans ignored")
    assert [area(item) for item in scene.objects] == [1.0, 1.0]  # the strip is read
    with pytest.raises(InputError, match=r"the scene is empty \(1 glTF triangle fans ignored\)"):
        gltf(tmp_path, [fan])


def test_gltf_morph_weights_are_told_where_they_deform(tmp_path: Path) -> None:
    morphing = [{**SHEET, "targets": [{"POSITION": 0}]}]
    for weight, remarks in (
        (0.0, ()),
        (1.0, ("1 glTF morph weights ignored: meshes taken without their morph targets",)),
    ):
        assert gltf(tmp_path, morphing, nodes=[{"mesh": 0, "weights": [weight]}]).warnings == remarks
        mesh = {"primitives": morphing, "weights": [weight]}
        assert gltf(tmp_path, [], meshes=[mesh]).warnings == remarks


def test_the_primitives_of_a_gltf_mesh_have_the_same_names_at_each_reading(tmp_path: Path) -> None:
    """Populations are drawn from a scene's hash, and `inspect --camera` refuses a scene of another."""
    house = {"nodes": [{"mesh": 0, "name": "house"}, {"mesh": 0}], "scenes": [{"nodes": [0, 1]}]}
    first = gltf(tmp_path, [SHEET, SHEET, SHEET], **house)
    assert {item.name for item in first.objects} == {"house", "house_1", "house_2", "1", "1_1", "1_2"}
    assert gltf(tmp_path, [SHEET, SHEET, SHEET], **house).content_hash() == first.content_hash()
    text = (tmp_path / "m.gltf").read_bytes()
    text += b" " * (-len(text) % 4)
    binary = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text
    assert opened(tmp_path / "m.glb", binary).content_hash() == first.content_hash()


def test_a_gltf_camera_takes_no_mesh_away(tmp_path: Path) -> None:
    lens = {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}
    nodes = [{"camera": 0, "mesh": 0, "name": "car", "children": [1], "translation": [0, 0, 9]}, {"mesh": 0}]
    scene = gltf(tmp_path, [SHEET], nodes=nodes, cameras=[lens])
    assert [(item.name, *item.vertices.min(axis=0)) for item in scene.objects] == [("car", 0, -9, 0), ("1", 0, -9, 0)]


@pytest.mark.parametrize(("file", "uri"), [("my scene.bin", "my%20scene.bin"), ("../m.bin", "../m.bin")])
def test_a_gltf_buffer_is_the_file_that_its_uri_means(tmp_path: Path, file: str, uri: str) -> None:
    """A blank is %20 in a URI (glTF 2.0, section 2.8): so exporters write it of a scene with one in its name."""
    folder = tmp_path / "models"
    folder.mkdir()
    gltf(folder, [SHEET])
    header = json.loads((folder / "m.gltf").read_text())
    (folder / file).write_bytes(base64.b64decode(header["buffers"][0]["uri"].partition(",")[2]))
    header["buffers"][0]["uri"] = uri
    assert covered(opened(folder / "m.gltf", json.dumps(header))) == 1.0


def test_gltf_instances_are_refused_where_the_file_does_not_require_them(tmp_path: Path) -> None:
    """A reader without the extension sees one tree of a wood."""
    trees = {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}}
    with pytest.raises(InputError, match=r"uses the glTF extension EXT_mesh_gpu_instancing; expected a file exported"):
        gltf(tmp_path, [SHEET], nodes=[trees], extensionsUsed=["EXT_mesh_gpu_instancing"])
    assert covered(gltf(tmp_path, [SHEET], extensionsUsed=["EXT_mesh_gpu_instancing"])) == 1.0


def test_what_a_gltf_file_hides_is_left_out_and_counted(tmp_path: Path) -> None:
    hidden = {"children": [1], "mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}}
    shown = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": True}}}
    scene = gltf(tmp_path, [SHEET], nodes=[hidden, {"mesh": 0}, shown], scenes=[{"nodes": [0, 2]}])
    assert [item.name for item in scene.objects] == ["2"]
    assert scene.warnings == ("1 invisible glTF nodes skipped, with everything below them",)
