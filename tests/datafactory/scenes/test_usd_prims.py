"""USD prims and stages: meshes and solids, polygons cut into triangles, units, axes, layers that are missing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, area, ops, read, signed_volume, translated, write_usda

from datafactory.scenes.readers.common import CHORD_ERROR, Notes, sphere
from datafactory.scenes.readers.polygons import triangulate
from shared.physics.errors import InputError


@pytest.mark.parametrize(
    ("left_handed", "scale", "order"),
    [
        (False, (1, 1, 1), 1),
        (True, (1, 1, 1), -1),
        (False, (-1, -1, 1), 1),
        (False, (-1, 1, 1), 1),
        (True, (1, -1, 1), -1),
        (False, (-1,) * 3, 1),
    ],
)
def test_outer_sides_stay_outside(tmp_path: Path, left_handed: bool, scale: tuple[int, ...], order: int) -> None:
    """A mirror turns the winding back; a left-handed prim's clockwise faces count as seen from outside."""
    orientation = 'uniform token orientation = "leftHanded"' if left_handed else ""
    body = f"""def Mesh "m" {{
      {CUBE}
      {orientation}
      {ops(scale=scale)}
    }}"""
    assert signed_volume(read(tmp_path, body).objects[0]) == pytest.approx(8.0 * order)


def test_holes_are_left_open(tmp_path: Path) -> None:
    item = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\nint[] holeIndices = [1]\n}}').objects[0]
    assert area(item) == pytest.approx(5 * 4.0)
    top = (item.vertices[item.triangles][:, :, 2] == 1).all(axis=1)
    assert not top.any()


PI = np.pi


SOLIDS = [
    ('def Cube "s" { double size = 2 }', 8.0),
    ('def Sphere "s" { double radius = 1 }', 4 / 3 * PI),
    ('def Cylinder "s" {\ndouble radius = 1\ndouble height = 3\n}', 3 * PI),
    ('def Cone "s" {\ndouble radius = 1\ndouble height = 3\n}', PI),
    ('def Capsule "s" {\ndouble radius = 1\ndouble height = 3\n}', 3 * PI + 4 / 3 * PI),
]


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize(("body", "volume"), SOLIDS)
def test_solids_are_closed_outward_and_inscribed(tmp_path: Path, body: str, volume: float, axis: str) -> None:
    kind = body.split()[1]
    if kind not in ("Cube", "Sphere"):
        body = body.replace("{", f'{{\nuniform token axis = "{axis}"', 1)
    item = read(tmp_path, body.replace("{ ", "{\n").replace(" }", "\n}")).objects[0]
    assert volume * (1 - 4 * CHORD_ERROR) <= signed_volume(item) <= volume * (1 + 1e-12)
    edges = np.sort(item.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()
    if kind in ("Cylinder", "Cone", "Capsule"):
        assert np.argmax(np.ptp(item.vertices, axis=0)) == "XYZ".index(axis)


def test_the_chord_error_of_a_sphere_is_the_stated_one(tmp_path: Path) -> None:
    item = read(tmp_path, 'def Sphere "s" {\ndouble radius = 3\n}').objects[0]
    corner = item.vertices[item.triangles]
    gap = 3 - np.linalg.norm(corner.mean(axis=1), axis=1)
    middles = 3 - np.linalg.norm((corner + np.roll(corner, 1, axis=1)) / 2, axis=2)
    assert 0 < max(gap.max(), middles.max()) <= 3 * CHORD_ERROR


@pytest.mark.parametrize(("axis", "size"), [("Z", (2, 3, 0)), ("X", (0, 3, 2)), ("Y", (2, 0, 3))])
def test_a_plane_faces_its_axis(tmp_path: Path, axis: str, size: tuple[int, int, int]) -> None:
    body = f'def Plane "s" {{\ndouble width = 2\ndouble length = 3\nuniform token axis = "{axis}"\n}}'
    item = read(tmp_path, body).objects[0]
    np.testing.assert_allclose(np.ptp(item.vertices, axis=0), size)
    a, b, c = item.vertices[item.triangles[0]]
    assert np.cross(b - a, c - a)["XYZ".index(axis)] > 0


@pytest.mark.parametrize("radius", [1e-12, 1e-4, 1e7, 1e40])
def test_solids_of_any_size_are_the_same_solid(radius: float) -> None:
    points, triangles = sphere(1.0)
    other, others = sphere(radius)
    assert len(other) == len(points)
    assert len(others) == len(triangles)
    assert np.linalg.norm(other, axis=1) == pytest.approx(radius, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("attribute", ['string protoIndices = "x"', "double[] protoIndices = [0.5]"])
def test_indices_of_another_type_are_no_indices(tmp_path: Path, attribute: str) -> None:
    body = f"""def PointInstancer "p" {{
      rel prototypes = </c>
      {attribute}
      point3f[] positions = [(0, 0, 0)]
    }}
    def Cube "c" {{
    }}"""
    assert [item.name for item in read(tmp_path, body).objects] == ["/c"]


@pytest.mark.parametrize(
    ("outline", "size"),
    [
        ([(2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 0)], 3.0),
        ([(0, 0), (4, 0), (4, 4), (2, 1), (2, 1), (0, 4)], 10.0),
        ([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], 12.0),
    ],
    ids=["an L", "a concave corner that stands twice, where no edge turns", "a hole joined by a doubled edge"],
)
def test_concave_polygons_keep_their_area_and_outline(outline: list[tuple[int, int]], size: float) -> None:
    """A fan would cover more and stick out into the yard: from 1 to 3 on both axes, so far as the outline leaves it."""
    for start in range(len(outline)):
        points = np.array([(x, y, 0.0) for x, y in outline[start:] + outline[:start]])
        notes = Notes()
        triangles, _ = triangulate(points, np.array([len(points)]), np.arange(len(points)), notes)
        corner = points[triangles]
        doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (doubled[:, 2] > 0).all()
        assert doubled[:, 2].sum() / 2 == pytest.approx(size)
        assert notes.sentences() == ()
        middle = corner.mean(axis=1)[:, :2]
        assert not ((middle > 1) & (middle < 3)).all(axis=1).any()


def test_a_bow_tie_is_counted() -> None:
    points = np.array([[0, 0, 0], [2, 3, 0], [2, 0, 0], [0, 2, 0]], dtype=np.float64)
    notes = Notes()
    triangulate(points, np.array([4]), np.arange(4), notes)
    assert notes.sentences() == ("1 faces whose outline crosses itself cut into a fan",)


def test_bad_faces_are_counted_and_the_others_keep_their_numbers() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    notes = Notes()
    _, faces = triangulate(points, np.array([2, 4, 3, 3]), np.array([0, 1, 0, 1, 2, 3, 0, 1, 9, 0, 1, 2]), notes)
    assert notes.sentences() == ("2 faces with fewer than three corners or an index out of range dropped",)
    assert faces.tolist() == [1, 1, 3]


def test_missing_units_and_axis_are_usd_defaults_and_said(tmp_path: Path) -> None:
    scene = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', 'doc = "bare"')
    assert np.ptp(scene.objects[0].vertices) == pytest.approx(0.02)
    assert any("no metersPerUnit" in warning for warning in scene.warnings)
    assert any("no upAxis" in warning for warning in scene.warnings)


def test_y_up_is_turned_to_z_up_without_a_mirror(tmp_path: Path) -> None:
    body = f'def Mesh "m" {{\n{CUBE}\n{translated(10, 20, 30)}}}'
    item = read(tmp_path, body, 'metersPerUnit = 1\n upAxis = "Y"').objects[0]
    np.testing.assert_allclose(item.vertices.mean(axis=0), [10, -30, 20])
    assert signed_volume(item) == pytest.approx(8.0)


@pytest.mark.parametrize(
    "body",
    [
        'def Xform "a" (references = @gone.usda@</X>) {\n}',
        'def Xform "a" (payload = @gone.usda@) {\n}',
        'def Xform "a" (instanceable = true\n references = @inner.usda@</A>) {\n}',
    ],
)
def test_a_missing_layer_is_one_line_with_its_name(
    tmp_path: Path, body: str, capfd: pytest.CaptureFixture[str]
) -> None:
    write_usda(tmp_path, 'def Xform "A" {\ndef Mesh "m" (references = @gone.usda@</X>) {\n}\n}', name="inner.usda")
    with pytest.raises(InputError, match=r"stage\.usda: .*gone\.usda.*</[aA]") as caught:
        read(tmp_path, f'{body}\ndef Cube "c" {{\n}}')
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_layers_in_other_units_are_told_with_the_size_they_give(tmp_path: Path) -> None:
    write_usda(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', 'metersPerUnit = 0.01\n upAxis = "Y"', name="inner.usda")
    scene = read(tmp_path, 'def "a" (references = @inner.usda@</m>) {\n}')
    assert any("1 layers are in units of 0.01 m within a stage of 1 m" in warning for warning in scene.warnings)
    assert any("1 layers have Y up within a stage with Z up" in warning for warning in scene.warnings)
    assert any("the scene measures 2 x 2 x 2 m" in warning for warning in scene.warnings)


SCRIPT = """
import os, signal, sys
from shared.processes.interrupt import run_command

class InterruptAt:
    def find_spec(self, name, path=None, target=None):
        if name == "pxr.Kind":  # loaded by UsdGeom, from C++
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, InterruptAt())

def load():
    import datafactory.scenes.usd_library
    print("went on")

run_command("program", load)
"""


def test_an_interrupt_while_usd_is_imported_is_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "program: interrupted\n")
