"""The entrance to every format, the mesh files, and the cleaning that all readers share."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from datafactory.scenes.readers.common import Notes, place_mesh
from datafactory.scenes.readers.open import KNOWN_SUFFIXES, open_scene, shipped_scenes, sionna_scenes
from shared.physics.errors import InputError


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_mesh_files_keep_their_size_and_outside(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box{suffix}"
    trimesh.creation.box(extents=[1, 2, 3]).export(path)
    scene = open_scene(str(path))
    assert (scene.name, scene.source) == ("box", str(path))
    (item,) = scene.objects
    assert volume(item.vertices, item.triangles) == pytest.approx(6.0)
    # glTF has y up: its y extent becomes the height. The others state nothing, and the scene says so.
    height = 2 if suffix == ".glb" else 3
    assert np.ptp(item.vertices[:, 2]) == pytest.approx(height)
    assert (len(scene.warnings) == 0) == (suffix == ".glb")


def test_gltf_turns_y_up_to_z_up_and_places_its_nodes(tmp_path: Path) -> None:
    file = trimesh.Scene()
    box = trimesh.creation.box()
    file.add_geometry(box, node_name="low", transform=trimesh.transformations.translation_matrix([1, 2, 3]))
    file.add_geometry(box, node_name="mirrored", transform=np.diag([-1.0, 1.0, 1.0, 1.0]))
    file.export(tmp_path / "two.glb")
    objects = {item.name: item for item in open_scene(str(tmp_path / "two.glb")).objects}
    np.testing.assert_allclose(objects["low"].vertices.mean(axis=0), [1, -3, 2], atol=1e-6)
    assert volume(objects["mirrored"].vertices, objects["mirrored"].triangles) == pytest.approx(1.0)


def test_gltf_that_moves_or_is_compressed_is_told(tmp_path: Path) -> None:
    parts = trimesh.Scene(trimesh.creation.box()).export(file_type="gltf")
    for name, content in parts.items():
        (tmp_path / name).write_bytes(content)
    header = json.loads(parts["model.gltf"])
    (tmp_path / "model.gltf").write_text(json.dumps({**header, "animations": [{}, {}]}))
    assert "2 glTF animations ignored: every object stands still" in open_scene(str(tmp_path / "model.gltf")).warnings
    (tmp_path / "model.gltf").write_text(json.dumps({**header, "extensionsRequired": ["KHR_draco_mesh_compression"]}))
    with pytest.raises(InputError, match="KHR_draco_mesh_compression"):
        open_scene(str(tmp_path / "model.gltf"))


def test_obj_groups_keep_their_materials(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl stone\nKd 1 0 0\nnewmtl wood\nKd 0 1 0\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\no A\nusemtl stone\nv 0 0 0\nv 2 0 0\nv 2 3 0\nv 0 3 0\nf 1 2 3 4\n"
        "o B\nusemtl wood\nv 0 0 1\nv 1 0 1\nv 1 1 1\nf 5 6 7\n"
    )
    objects = open_scene(str(tmp_path / "m.obj")).objects
    assert sorted((item.material, len(item.triangles)) for item in objects) == [("stone", 2), ("wood", 1)]


@pytest.mark.parametrize("suffix", KNOWN_SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\x00\x01 no scene at all"])
def test_torn_files_are_one_line(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"torn{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"torn{suffix}: ") as caught:
        open_scene(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", KNOWN_SUFFIXES)
def test_missing_files_and_folders_are_one_line(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match=f"gone{suffix}: no such file"):
        open_scene(str(tmp_path / f"gone{suffix}"))
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(InputError, match="no such file"):
        open_scene(str(tmp_path / f"folder{suffix}"))


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        (".usda", '#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\ndef Xform "a" {\n}\n'),
        (".xml", '<scene version="2.1.0"><bsdf type="diffuse" id="m"/></scene>'),
        (".obj", "v 0 0 0\nv 1 0 0\n"),
    ],
)
def test_a_scene_with_nothing_in_it_is_refused(tmp_path: Path, suffix: str, content: str) -> None:
    (tmp_path / f"nothing{suffix}").write_text(content)
    with pytest.raises(InputError, match=r"the scene is empty.*expected at least one triangle mesh or point target"):
        open_scene(str(tmp_path / f"nothing{suffix}"))


def test_an_unknown_suffix_names_the_known_ones() -> None:
    with pytest.raises(
        InputError, match=r"scene\.blend: unknown scene format '\.blend'; expected one of \.usd .*sionna:"
    ):
        open_scene("scene.blend")


def test_shipped_scenes_are_found_by_name_and_unknown_ones_listed() -> None:
    scenes = shipped_scenes()
    assert {"street", "street.xml", "test_range", "tiny", "effects/wall"} <= scenes.keys()
    assert next(iter(scenes)) == "street"
    tiny, file = open_scene("shipped:tiny"), open_scene(str(scenes["tiny"]))
    assert (tiny.name, tiny.source) == ("tiny", "shipped:tiny")
    assert tiny.content_hash() == file.content_hash()
    assert open_scene("shipped:effects/wall").name == "wall"
    with pytest.raises(InputError, match=r"shipped:atlantis: unknown shipped scene; expected street, .*tiny"):
        open_scene("shipped:atlantis")


def test_sionna_scenes_are_found_by_name_and_unknown_ones_listed() -> None:
    scene = open_scene("sionna:simple_reflector")
    assert (scene.name, scene.source, len(scene.objects)) == ("simple_reflector", "sionna:simple_reflector", 1)
    assert {"munich", "etoile", "floor_wall"} <= sionna_scenes().keys()
    with pytest.raises(InputError, match=r"sionna:atlantis: unknown Sionna scene; expected .*munich"):
        open_scene("sionna:atlantis")


@np.errstate(invalid="ignore")
def test_placing_counts_each_reason_and_leaves_out_unused_points() -> None:
    points = np.array([[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [np.inf, 0, 0], [2, 0, 0], [1e30, 0, 0]])
    triangles = np.array([[1, 2, 3], [1, 2, 7], [1, -1, 2], [1, 2, 4], [1, 2, 5], [2, 2, 3], [1, 3, 6]])
    notes = Notes()
    vertices, faces, used = place_mesh(points, triangles, np.eye(4), notes)
    np.testing.assert_array_equal(used, [1, 2, 3])
    np.testing.assert_array_equal(vertices, points[used])
    np.testing.assert_array_equal(faces, [[0, 1, 2]])
    assert notes.sentences() == (
        "2 triangles with a vertex index out of range dropped",
        "1 triangles with a NaN or infinite vertex dropped",
        "1 triangles with a vertex beyond 1e+09 m dropped",
        "2 triangles without area dropped",
    )
    assert (vertices.dtype, faces.dtype) == (np.float64, np.int32)


def test_thin_and_small_triangles_stay_and_nothing_gives_nothing() -> None:
    thin = np.array([[0, 0, 0], [1000.0, 0, 0], [500.0, 1e-6, 0]])
    for points in (thin, thin * 1e-9):
        assert len(place_mesh(points, np.array([[0, 1, 2]]), np.eye(4), Notes())[1]) == 1
    vertices, faces, _ = place_mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), np.eye(4), Notes())
    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))


def test_a_mirror_reverses_the_winding_and_a_rotation_does_not() -> None:
    box = trimesh.creation.box()
    for diagonal, scale in (((-1, 1, 1, 1), 1), ((-1, -1, 1, 1), 1), ((-2, -2, -2, 1), 8)):
        matrix = np.diag(np.array(diagonal, dtype=np.float64))
        vertices, faces, _ = place_mesh(box.vertices, box.faces, matrix, Notes())
        assert volume(vertices, faces) == pytest.approx(scale)
