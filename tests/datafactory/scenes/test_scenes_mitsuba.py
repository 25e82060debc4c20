"""Mitsuba XML: shapes, transforms, material names, and agreement with Sionna's own loader."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from usd_files import signed_volume

from datafactory.inspection.scene import examine_scene
from datafactory.run.preparation import prepared_scene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.mitsuba import read_mitsuba
from datafactory.scenes.readers.open import open_scene, sionna_scenes

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
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def compare_with_sionna(path: Path) -> None:
    """Same objects, same bounds [m], same materials; Sionna drops "mesh-" and "mat-" from the names."""
    from datafactory.paths.backend import select_variant

    select_variant()
    import sionna.rt

    theirs = sionna.rt.load_scene(str(path), merge_shapes=False).objects
    ours = {item.name.removeprefix("mesh-"): item for item in open_scene(str(path)).objects}
    assert ours.keys() == theirs.keys()
    for name, item in theirs.items():
        box = item.mi_mesh.bbox()
        limits = [np.array(box.min).ravel(), np.array(box.max).ravel()]
        np.testing.assert_allclose(
            [ours[name].vertices.min(axis=0), ours[name].vertices.max(axis=0)], limits, atol=1e-4
        )
        assert ours[name].material.removeprefix("mat-") == item.radio_material.name


@pytest.mark.parametrize(
    "name", ["box_two_screens", "simple_street_canyon_with_cars", "simple_wedge", "triple_reflector"]
)
def test_built_in_scenes_agree_with_sionna(name: str) -> None:
    compare_with_sionna(sionna_scenes()[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["etoile", "florence", "munich", "san_francisco"])
def test_built_in_cities_agree_with_sionna(name: str) -> None:
    compare_with_sionna(sionna_scenes()[name])


@pytest.mark.skipif(not CAMPUS.is_file(), reason="the reference campus is not beside the checkout")
def test_the_campus_has_all_its_shapes() -> None:
    scene = open_scene(str(CAMPUS))
    assert len(scene.objects) == 289
    assert {item.material for item in scene.objects} == {"mat-itu_concrete", "mat-itu_marble", "mat-itu_metal"}
    assert any("ı" in item.name for item in scene.objects)
