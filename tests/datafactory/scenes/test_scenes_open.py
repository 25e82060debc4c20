"""The entrance to every format, mesh files, cleaning; Mitsuba XML, in agreement with Sionna's own loader."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from processes import python
from usd_files import signed_volume

from datafactory.inspection.scene import examine_scene
from datafactory.run.preparation import prepared_scene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.common import Notes, place_mesh
from datafactory.scenes.readers.mitsuba import read_mitsuba
from datafactory.scenes.readers.open import KNOWN_SUFFIXES, open_scene, shipped_scenes, sionna_scenes
from shared.physics.errors import InputError


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_mesh_files_keep_their_size_and_outside(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box{suffix}"
    trimesh.creation.box(extents=[1, 2, 3]).export(path)
    scene = open_scene(str(path))
    assert (scene.name, scene.source) == ("box", str(path))
    (item,) = scene.objects
    assert signed_volume(item) == pytest.approx(6.0)
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
    assert signed_volume(objects["mirrored"]) == pytest.approx(1.0)


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


CAMPUS = (
    Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "mitsuba_campus" / "Terrains" / "test_scene.xml"
)


def xml(folder: Path, body: str, name: str = "scene.xml") -> Path:
    path = folder / name
    path.write_text(f'<scene version="2.1.0">{body}</scene>', encoding="utf-8")
    return path


def test_transforms_multiply_in_the_order_written_and_in_float64(tmp_path: Path) -> None:
    body = """<shape type="cube" id="c"><transform name="to_world">
      <scale value="0.5"/><translate x="1"/><rotate z="1" angle="90"/><translate z="1000000.1"/>
    </transform></shape>"""
    item = read_mitsuba(xml(tmp_path, body)).objects[0]
    np.testing.assert_allclose(item.vertices.mean(axis=0), [0, 1, 1000000.1], rtol=0, atol=1e-8)
    assert signed_volume(item) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(
    "step",
    [
        '<matrix value="0 0 1 4  1 0 0 5  0 1 0 6  0 0 0 1"/>',
        '<lookat origin="4, 5, 6" target="5, 5, 6" up="0, 0, 1"/>',
        '<rotate value="1 1 1" angle="120"/><translate x="4" y="5" z="6"/>',
    ],
)
def test_one_pose_written_in_three_ways(tmp_path: Path, step: str) -> None:
    """z forward becomes x, x becomes y, y becomes z: the cyclic exchange is a turn by 120 deg about (1, 1, 1)."""
    body = f"""<shape type="cylinder" id="c"><point name="p1" z="3"/><float name="radius" value="0.01"/>
      <transform name="to_world">{step}</transform></shape>"""
    item = read_mitsuba(xml(tmp_path, body)).objects[0]
    np.testing.assert_allclose(item.vertices.min(axis=0), [4, 5, 6], atol=0.011)
    np.testing.assert_allclose(item.vertices.max(axis=0), [7, 5, 6], atol=0.011)


@pytest.mark.parametrize("flips", [0, 1])
def test_mirrors_keep_the_outside_and_flip_normals_turns_it(tmp_path: Path, flips: int) -> None:
    body = f"""<shape type="cube" id="c"><boolean name="flip_normals" value="{"true" if flips else "false"}"/>
      <transform name="to_world"><scale x="-1"/></transform></shape>"""
    assert signed_volume(read_mitsuba(xml(tmp_path, body)).objects[0]) == pytest.approx(-8.0 if flips else 8.0)


def test_shapes_given_by_parameters(tmp_path: Path) -> None:
    body = """<shape type="sphere" id="s"><point name="center" value="1, 2, 3"/><float name="radius" value="2"/></shape>
      <shape type="cylinder" id="t"><point name="p0" x="0" y="0" z="0"/><point name="p1" x="6" y="0" z="0"/></shape>
      <shape type="rectangle" id="r"/><shape type="disk" id="d"/>"""
    sphere, tube, rectangle, disk = read_mitsuba(xml(tmp_path, body)).objects
    np.testing.assert_allclose(np.linalg.norm(sphere.vertices - [1, 2, 3], axis=1), 2)
    np.testing.assert_allclose(np.linalg.norm(tube.vertices[:, 1:], axis=1), 1)
    assert (tube.vertices[:, 0].min(), tube.vertices[:, 0].max()) == pytest.approx((0, 6))
    middle = tube.vertices[tube.triangles]
    normals = np.cross(middle[:, 1] - middle[:, 0], middle[:, 2] - middle[:, 0])
    assert (np.einsum("ij,ij->i", normals[:, 1:], middle.mean(axis=1)[:, 1:]) > 0).all()
    np.testing.assert_allclose(np.ptp(rectangle.vertices, axis=0), [2, 2, 0])
    np.testing.assert_allclose(np.ptp(disk.vertices, axis=0), [2, 2, 0])


def test_materials_are_named_by_their_outer_id_and_need_not_be_known(tmp_path: Path) -> None:
    body = """<bsdf type="twosided" id="mat-itu_concrete"><bsdf type="diffuse"/></bsdf>
      <bsdf type="some-radio-material-of-tomorrow" id="mat-x"><float name="thickness" value="0.1"/></bsdf>
      <shape type="cube" id="a"><ref id="mat-itu_concrete" name="bsdf"/></shape>
      <shape type="cube" id="b"><ref id="mat-x"/></shape>
      <shape type="cube" id="c"><bsdf type="diffuse"/></shape>"""
    scene = read_mitsuba(xml(tmp_path, body))
    assert [(item.name, item.material) for item in scene.objects] == [
        ("a", "mat-itu_concrete"),
        ("b", "mat-x"),
        ("c", ""),
    ]


@pytest.mark.parametrize(
    "inner",
    [
        '<bsdf type="diffuse" id="glass"/>',
        '<bsdf type="bumpmap"><texture type="bitmap" id="t"/><bsdf type="diffuse" id="glass"/></bsdf>',
        '<bsdf type="itu-radio-material"><string name="type" value="glass"/></bsdf>',
        '<ref id="glass"/>',
    ],
)
def test_a_wrapper_without_a_name_has_that_of_what_it_wraps(tmp_path: Path, inner: str) -> None:
    other = '<bsdf type="diffuse" id="glass"/>' if "ref" in inner else ""
    body = f"""{other}<shape type="cube" id="a"><bsdf type="twosided">{inner}</bsdf></shape>
      <shape type="cube" id="b"><bsdf type="twosided"><ref id="gone"/><bsdf type="diffuse"/></bsdf></shape>"""
    assert [item.material for item in read_mitsuba(xml(tmp_path, body)).objects] == ["glass", ""]


def test_a_stated_itu_type_counts_more_than_the_id(tmp_path: Path) -> None:
    """Sionna reads a type of its own plugin, and of any BSDF whose id begins with itu_ or mat-itu_."""
    body = """<bsdf type="itu-radio-material" id="wood-mat"><string name="type" value="metal"/>
        <float name="thickness" value="1."/></bsdf>
      <bsdf type="itu-radio-material" id="glass"><string name="type" value="glass"/></bsdf>
      <bsdf type="diffuse" id="mat-itu_concrete"><string name="type" value="brick"/></bsdf>
      <bsdf type="radio-material" id="brick"><string name="type" value="metal"/>
        <float name="relative_permittivity" value="3"/><float name="thickness" value="0.2"/></bsdf>
      <shape type="cube" id="a"><ref id="wood-mat"/></shape><shape type="cube" id="b"><ref id="glass"/></shape>
      <shape type="cube" id="c"><ref id="mat-itu_concrete"/></shape><shape type="cube" id="d"><ref id="brick"/></shape>
      <shape type="cube" id="e"><bsdf type="itu-radio-material"><string name="type" value="wet_ground"/></bsdf></shape>
      <shape type="cube" id="f"><ref id="wood-mat"/></shape>"""
    scene = open_scene(str(xml(tmp_path, body)))
    mapping = load_materials().map_materials([item.material for item in scene.objects], scene.stated)
    assert [mapping[item.material].name for item in scene.objects] == [
        "metal", "glass", "brick", "brick", "wet_ground", "metal"
    ]  # fmt: skip
    assert [mapping.entries[name][1] for name in ("wood-mat", "glass", "wet_ground")] == [
        "stated 'metal'", "name", "name"
    ]  # fmt: skip
    assert scene.warnings == (
        "1 materials state relative_permittivity, which is not taken: the material table counts",
        "2 materials state thickness, which is not taken: the material table counts",
    )
    assert scene.content_hash() != replace(scene, stated={}).content_hash()


def test_what_sionna_states_of_a_named_scene_reaches_its_frames() -> None:
    scene = open_scene("sionna:box_one_screen")
    prepared = prepared_scene(scene, load_materials(), lambda line: None)
    assert [prepared.materials[name].name for name in ("box-mat", "screen-mat")] == ["metal", "glass"]
    assert [item.material for item in examine_scene(scene, load_materials()).materials] == ["metal", "glass"]


def test_defaults_includes_and_file_names_beyond_ascii(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box().export(tmp_path / "meshes" / "Kapalı_Yüzme.ply")
    xml(tmp_path, '<bsdf type="diffuse" id="mat-metal"/>', "materials.xml")
    body = """<default name="size" value="3"/><include filename="materials.xml"/>
      <shape type="ply" id="mesh-Yüzme"><string name="filename" value="meshes/Kapalı_Yüzme.ply"/>
      <transform name="to_world"><scale value="$size"/></transform><ref id="mat-metal"/></shape>"""
    (item,) = read_mitsuba(xml(tmp_path, body)).objects
    assert (item.name, item.material) == ("mesh-Yüzme", "mat-metal")
    assert signed_volume(item) == pytest.approx(27.0)


def test_files_are_looked_for_in_the_folders_of_path_too(tmp_path: Path) -> None:
    """The last one first, and the scene's own folder at last, as Mitsuba does."""
    for folder, edge in (("", 1.0), ("a", 2.0), ("b", 3.0)):
        (tmp_path / folder).mkdir(exist_ok=True)
        trimesh.creation.box(extents=[edge] * 3).export(tmp_path / folder / f"in_{folder or 'scene'}.ply")
        trimesh.creation.box(extents=[edge] * 3).export(tmp_path / folder / "in_all.ply")
    files = ("in_all", "in_scene", "in_a", "in_b")
    shapes = [f'<shape type="ply"><string name="filename" value="{file}.ply"/></shape>' for file in files]
    scene = read_mitsuba(xml(tmp_path, f'{"".join(shapes)}<path value="a"/><path value="b"/>'))
    assert [float(np.ptp(item.vertices[:, 0])) for item in scene.objects] == [3.0, 1.0, 2.0, 3.0]


def test_unsupported_shapes_and_bad_triangles_are_counted(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n")
    body = """<shape type="hair" id="h"/><shape type="bsplinecurve" id="i"/><shape type="hair" id="j"/>
      <shape type="obj" id="m"><string name="filename" value="m.obj"/></shape>"""
    scene = read_mitsuba(xml(tmp_path, body))
    assert [len(item.triangles) for item in scene.objects] == [1]
    assert set(scene.warnings) == {
        "2 shapes of type 'hair' ignored",
        "1 shapes of type 'bsplinecurve' ignored",
        "1 triangles with a NaN or infinite vertex dropped",
        "1 triangles without area dropped",
    }


def test_reading_leaves_the_choice_of_llvm_open() -> None:
    """Dr.Jit takes whatever libLLVM it finds when it is imported; with the wrong one the process aborts later."""
    script = (
        "import sys; from datafactory.scenes.readers.open import open_scene; open_scene('sionna:box');"
        "print(sorted({'drjit', 'mitsuba', 'sionna'} & sys.modules.keys()))"
    )
    assert python("-c", script) == "[]\n"


CITIES = [pytest.param(name, marks=pytest.mark.slow) for name in ("etoile", "florence", "munich", "san_francisco")]


@pytest.mark.parametrize(
    "name", ["box_two_screens", "simple_street_canyon_with_cars", "simple_wedge", "triple_reflector", *CITIES]
)
def test_built_in_scenes_agree_with_sionna(name: str) -> None:
    """Same objects, same bounds [m], same materials; Sionna drops "mesh-" and "mat-" from the names."""
    from datafactory.paths.backend import select_variant

    select_variant()
    import sionna.rt

    path = sionna_scenes()[name]
    theirs = sionna.rt.load_scene(str(path), merge_shapes=False).objects
    ours = {item.name.removeprefix("mesh-"): item for item in open_scene(str(path)).objects}
    assert ours.keys() == theirs.keys()
    for part, item in theirs.items():
        box = item.mi_mesh.bbox()
        limits = [np.array(box.min).ravel(), np.array(box.max).ravel()]
        np.testing.assert_allclose(
            [ours[part].vertices.min(axis=0), ours[part].vertices.max(axis=0)], limits, atol=1e-4
        )
        assert ours[part].material.removeprefix("mat-") == item.radio_material.name


@pytest.mark.skipif(not CAMPUS.is_file(), reason="the reference campus is not beside the checkout")
def test_the_campus_has_all_its_shapes() -> None:
    scene = open_scene(str(CAMPUS))
    assert len(scene.objects) == 289
    assert {item.material for item in scene.objects} == {"mat-itu_concrete", "mat-itu_marble", "mat-itu_metal"}
    assert any("ı" in item.name for item in scene.objects)
