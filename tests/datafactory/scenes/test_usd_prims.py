"""The geometry of single USD prims: polygon meshes and solids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, area, ops, read, signed_volume

from datafactory.scenes.readers.common import CHORD_ERROR, sphere


@pytest.mark.parametrize(
    ("left_handed", "scale", "order"),
    [
        (False, (1, 1, 1), 1),
        (True, (1, 1, 1), -1),
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


def test_bad_triangles_are_dropped_and_counted(tmp_path: Path) -> None:
    body = """def Mesh "m" {
      point3f[] points = [(0,0,0), (1,0,0), (0,1,0), (nan,0,0), (2,0,0), (inf,0,0)]
      int[] faceVertexCounts = [3, 3, 3, 3, 3]
      int[] faceVertexIndices = [0,1,2, 0,1,3, 0,1,4, 0,1,77, 1,2,5]
      uniform token subdivisionScheme = "none"
    }"""
    scene = read(tmp_path, body)
    assert scene.objects[0].triangles.tolist() == [[0, 1, 2]]
    assert len(scene.objects[0].vertices) == 3
    assert set(scene.warnings) == {
        "2 triangles with a NaN or infinite vertex dropped",
        "1 triangles without area dropped",
        "1 faces with fewer than three corners or an index out of range dropped",
    }


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
    assert np.linalg.norm(other, axis=1) == pytest.approx(radius)


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
