"""USD prims and stages: meshes and solids, polygons cut into triangles, units, axes, layers that are missing.

USD as it is found: materials that were not passed on, missing geometry, variants, X up.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, TWINS, Twin, area, cube, ops, read, signed_volume, translated, write_usda

from datafactory.scenes.readers.common import CHORD_ERROR, Notes, Reading, parse_variants, sphere
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.readers.usd_prims import triangulate
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError


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


def test_concave_polygons_keep_their_area_and_outline() -> None:
    """An L of area 3: a fan from its corner 0 would cover 4 and stick out into the yard."""
    outline = np.array([[2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0], [0, 0, 0]], dtype=np.float64)
    for start in range(6):
        points = np.roll(outline, start, axis=0)
        notes = Notes()
        triangles, _ = triangulate(points, np.array([6]), np.arange(6), notes)
        corner = points[triangles]
        doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (doubled[:, 2] > 0).all()
        assert doubled[:, 2].sum() / 2 == pytest.approx(3.0)
        assert notes.sentences() == ()
        middle = corner.mean(axis=1)
        assert not ((middle[:, 0] > 1) & (middle[:, 1] > 1)).any()


def test_a_hole_joined_by_a_doubled_edge_stays_open() -> None:
    outer, inner = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
    ring = [*outer, outer[0], inner[0], *inner[1:], inner[0]]
    points = np.array([(x, y, 0.0) for x, y in ring])
    triangles, _ = triangulate(points, np.array([len(ring)]), np.arange(len(ring)), Notes())
    corner = points[triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.abs(doubled[:, 2]).sum() / 2 == pytest.approx(16 - 4)


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


BOX = f"""def Mesh "box" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
  {CUBE}
  rel material:binding = </mtl/wood>
}}
"""


@pytest.mark.parametrize(
    "lost",
    [
        'def Scope "mtl" (references = @gone.mtlx@</MaterialX/Materials>) {}',  # USD's wheel does not read MaterialX
        'def "mtl" {\n def Material "wood" (references = @gone.usd@) {}\n}',
        'def "mtl" {\n def "wood" (payload = @gone.usd@) {}\n}',  # known by the binding alone
        'def Scope "Looks" {\n def "steel" (references = @gone.usd@</Looks/steel>) {}\n}',
        'def Material "m" {\n def "s" (references = @shaders/gone.usda@) {}\n}',
        'def Material "m" (references = </nowhere>) {}',
    ],
)
def test_a_lost_material_leaves_the_default_and_a_warning(tmp_path: Path, lost: str) -> None:
    scene = read(tmp_path, BOX + lost)
    assert [item.name for item in scene.objects] == ["/box"]
    (warning,) = [text for text in scene.warnings if "cannot be opened" in text]
    assert warning.startswith("1 references to materials, shaders or textures cannot be opened, the first ")
    assert scene.objects[0].material in ("", "wood")


LOST_GEOMETRY = BOX + "\n".join(f'def "{name}" (references = @{name}.usd@) {{}}' for name in ("b", "a", "c"))


def test_lost_geometry_is_always_the_same_error(tmp_path: Path) -> None:
    messages = set()
    for _ in range(3):
        with pytest.raises(InputError) as caught:
            read(tmp_path, LOST_GEOMETRY)
        messages.add(str(caught.value))
    (message,) = messages
    assert "@a.usd@" in message
    assert "(and 2 more)" in message
    assert "--allow-missing" in message
    assert "\n" not in message


def test_allow_missing_goes_on_and_says_what_is_left_out(tmp_path: Path) -> None:
    scene = open_scene(str(write_usda(tmp_path, LOST_GEOMETRY)), Reading(allow_missing=True))
    assert [item.name for item in scene.objects] == ["/box"]
    assert any("3 references to geometry cannot be opened and are left out" in text for text in scene.warnings)


def test_a_lost_reference_of_what_is_named_like_materials_but_has_geometry_is_an_error(tmp_path: Path) -> None:
    body = f'def Xform "materials" (references = @gone.usd@) {{\n def Mesh "m" {{\n{CUBE}\n}}\n}}'
    with pytest.raises(InputError, match=r"gone\.usd"):
        read(tmp_path, body)


CAR = f"""def Xform "car" (
  variants = {{
    string body = "van"
    string wheels = "none"
  }}
  prepend variantSets = ["body", "wheels"]
) {{
  variantSet "body" = {{
    "van" {{
      {cube("van")}
    }}
    "sedan" (
      prepend variantSets = "roof"
    ) {{
      {cube("sedan")}
      variantSet "roof" = {{
        "open" {{
        }}
        "closed" {{
          {cube("roof")}
        }}
      }}
    }}
  }}
  variantSet "wheels" = {{
    "none" {{
    }}
    "four" {{
      {cube("wheel")}
    }}
  }}
}}"""


def names(folder: Path, body: str, *variants: str) -> list[str]:
    path = write_usda(folder, body)
    return [item.name for item in open_scene(str(path), Reading(parse_variants(variants))).objects]


def test_variants_are_selected_over_the_files_own_and_within_one_another(tmp_path: Path) -> None:
    assert names(tmp_path, CAR) == ["/car/van"]
    assert names(tmp_path, CAR, "wheels=four") == ["/car/wheel", "/car/van"]
    assert names(tmp_path, CAR, "roof=closed", "body=sedan") == ["/car/roof", "/car/sedan"]


def test_variants_within_instances_are_selected(tmp_path: Path) -> None:
    write_usda(tmp_path, CAR, METRES_Z_UP, "car.usda")
    write_usda(tmp_path, 'def Xform "lot" {\n def "one" (references = @car.usda@</car>) {\n}\n}', name="lot.usda")
    lots = [
        f'def "l{n}" (instanceable = true\n references = @lot.usda@</lot>) {{\n{translated(9 * n, 0, 0)}}}'
        for n in range(2)
    ]
    assert names(tmp_path, "\n".join(lots)) == ["/l0/one/van", "/l1/one/van"]
    assert names(tmp_path, "\n".join(lots), "body=sedan") == ["/l0/one/sedan", "/l1/one/sedan"]


@pytest.mark.parametrize(
    ("variants", "message"),
    [
        (["paint=red"], "--variant: no prim has a variant set 'paint'; expected body, wheels"),
        (["body=truck"], "--variant: body has no variant 'truck'; expected sedan, van"),
        (["body"], "--variant: 'body'; expected set=name"),
        (["body=van", "body=sedan"], "--variant: 'body' is given as 'van' and as 'sedan'"),
    ],
)
def test_a_variant_that_there_is_not_is_named_with_those_that_there_are(
    tmp_path: Path, variants: list[str], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        names(tmp_path, CAR, *variants)
    assert message in str(caught.value)


def test_other_formats_have_no_variants(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="has no variants; expected a USD file"):
        open_scene(str(path), Reading((("a", "b"),)))


CORNERS = np.array([(0.5, 0.25, 0.0), (2.0, 0.25, 0.0), (2.0, 1.5, 0.75), (0.5, 1.5, 0.75)])


def twin_scene(folder: Path, twin: Twin) -> Scene:
    """A sheet that drives and turns about the vertical, a cross section that goes straight on, and a walker."""
    turning = {f"rotate{twin.up}": {0: 0, 24: 90}}
    body = f"""def Mesh "sheet" {{
      point3f[] points = {twin.places(CORNERS)}
      int[] faceVertexCounts = [4]
      int[] faceVertexIndices = [0, 1, 2, 3]
      {ops(translate={0: twin.place((3, 4, 5)), 24: twin.place((3, 4, 14))}, **turning)}
    }}
    def Xform "post" {{
      custom float radar:rcs_dbsm = 3
      custom double3 radar:velocity = {twin.turned((-1.0, 2.0, 0.5))}
      {ops(translate=twin.place((18.0, 6.0, 1.0)))}
    }}
    def Xform "walker" {{
      custom token radar:target = "pedestrian"
      {ops(translate={0: twin.place((10.0, -1.0, 0.0)), 24: twin.place((10.0, 0.5, 0.0))})}
    }}"""
    return read(folder, body, f"{twin.metadata}\n timeCodesPerSecond = 24")


@pytest.mark.parametrize("twin", TWINS, ids=str)
def test_twins_in_other_axes_and_units_are_the_same_scene(tmp_path: Path, twin: Twin) -> None:
    """Whatever is up, and in metres or centimetres: places, velocities and headings at a time, computed by hand."""
    scene = twin_scene(tmp_path, twin)
    sheet, (post, walker) = scene.objects[0].at(0.5), (target.at(0.5) for target in scene.targets)
    half = np.sqrt(0.5) * np.array([(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, np.sqrt(2.0))])
    turned = CORNERS @ half.T
    np.testing.assert_allclose(sheet.vertices, turned + np.array([3.0, 4.0, 9.5]), atol=1e-6)
    velocity = 0.5 * np.pi * np.cross([0.0, 0.0, 1.0], turned) + np.array([0.0, 0.0, 9.0])
    np.testing.assert_allclose(sheet.velocities, velocity, atol=1e-6)
    np.testing.assert_allclose([post.position, post.velocity], [(17.5, 7.0, 1.25), (-1.0, 2.0, 0.5)], atol=1e-9)
    np.testing.assert_allclose([walker.position, walker.velocity], [(10.0, -0.25, 0.0), (0.0, 1.5, 0.0)], atol=1e-9)
    np.testing.assert_allclose(walker.axes, np.eye(3), atol=1e-9)
