"""USD to metres, z up and triangles: on small stages written here, and on the reference stages where present."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.readers.primitives import CHORD_ERROR
from datafactory.scenes.readers.triangulation import triangulate
from datafactory.scenes.readers.usd import read_usd
from datafactory.scenes.scene import Scene, SceneObject
from shared.physics.errors import InputError

REFERENCE = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "usd"
needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference stages are not beside the checkout")

METRES_Z_UP = 'metersPerUnit = 1\n upAxis = "Z"'
# A cube of edge 2 about the origin, corners numbered x + 2 y + 4 z, counter-clockwise seen from outside.
CUBE_POINTS = "point3f[] points = [(-1,-1,-1),(1,-1,-1),(-1,1,-1),(1,1,-1),(-1,-1,1),(1,-1,1),(-1,1,1),(1,1,1)]"
CUBE_FACES = """int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
    uniform token subdivisionScheme = "none"
"""
CUBE = f"{CUBE_POINTS}\n    {CUBE_FACES}"


def stage(folder: Path, body: str, metadata: str = METRES_Z_UP, name: str = "stage.usda") -> Path:
    path = folder / name
    path.write_text(f"#usda 1.0\n(\n {metadata}\n)\n{body}\n", encoding="utf-8")
    return path


def read(folder: Path, body: str, metadata: str = METRES_Z_UP) -> Scene:
    return open_scene(str(stage(folder, body, metadata)))


def signed_volume(item: SceneObject) -> float:
    """sum a . (b x c) / 6 [m^3]: positive for a closed surface whose normals point outwards."""
    a, b, c = (item.vertices[item.triangles[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def area(item: SceneObject) -> float:
    a, b, c = (item.vertices[item.triangles[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def translated(x: float, y: float, z: float) -> str:
    return f'double3 xformOp:translate = ({x}, {y}, {z})\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'


@pytest.mark.parametrize(("metres", "volume"), [(1.0, 8.0), (0.01, 8e-6), (0.0254, 8 * 0.0254**3)])
def test_units_are_brought_to_metres(tmp_path: Path, metres: float, volume: float) -> None:
    scene = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', f'metersPerUnit = {metres}\n upAxis = "Z"')
    assert signed_volume(scene.objects[0]) == pytest.approx(volume, rel=1e-12)


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


def test_nested_transforms_are_applied_from_the_inside_out(tmp_path: Path) -> None:
    # Inner: move by (1, 0, 0). Outer: turn by 90 deg about z, then move by (0, 0, 5).
    body = f"""def Xform "outer" {{
      double xformOp:rotateZ = 90
      double3 xformOp:translate = (0, 0, 5)
      uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
      def Xform "inner" {{
        {translated(1, 0, 0)}
        def Mesh "m" {{
        {CUBE}
        }}
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
      def Mesh "m" {{
      {CUBE}
      }}
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
      double3 xformOp:scale = {scale}
      uniform token[] xformOpOrder = ["xformOp:scale"]
    }}"""
    assert signed_volume(read(tmp_path, body).objects[0]) == pytest.approx(8.0 * order)


def test_concave_polygons_keep_their_area_and_outline() -> None:
    """An L of area 3: a fan from its corner 0 would cover 4 and stick out into the yard."""
    outline = np.array([[2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0], [0, 0, 0]], dtype=np.float64)
    for start in range(6):
        points = np.roll(outline, start, axis=0)
        cut = triangulate(points, np.array([6]), np.arange(6))
        corner = points[cut.triangles]
        doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (doubled[:, 2] > 0).all()
        assert doubled[:, 2].sum() / 2 == pytest.approx(3.0)
        assert cut.crossing_faces == 0
        middle = corner.mean(axis=1)
        assert not ((middle[:, 0] > 1) & (middle[:, 1] > 1)).any()


def test_a_hole_joined_by_a_doubled_edge_stays_open() -> None:
    outer, inner = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
    ring = [*outer, outer[0], inner[0], *inner[1:], inner[0]]
    points = np.array([(x, y, 0.0) for x, y in ring])
    cut = triangulate(points, np.array([len(ring)]), np.arange(len(ring)))
    corner = points[cut.triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.abs(doubled[:, 2]).sum() / 2 == pytest.approx(16 - 4)


def test_a_bow_tie_is_counted() -> None:
    points = np.array([[0, 0, 0], [2, 3, 0], [2, 0, 0], [0, 2, 0]], dtype=np.float64)
    assert triangulate(points, np.array([4]), np.arange(4)).crossing_faces == 1


def test_bad_faces_are_counted_and_the_others_keep_their_numbers() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    cut = triangulate(points, np.array([2, 4, 3, 3]), np.array([0, 1, 0, 1, 2, 3, 0, 1, 9, 0, 1, 2]))
    assert cut.bad_faces == 2
    assert cut.faces.tolist() == [1, 1, 3]


def test_holes_are_left_open(tmp_path: Path) -> None:
    item = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\nint[] holeIndices = [1]\n}}').objects[0]
    assert area(item) == pytest.approx(5 * 4.0)
    top = (item.vertices[item.triangles][:, :, 2] == 1).all(axis=1)
    assert not top.any()


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
      def Mesh "m" {{
      {CUBE}
      }}
      def Xform "b" {{
        custom token radar:material = "itu_glass"
        def Mesh "m" {{
        {CUBE}
        }}
      }}
    }}"""
    assert [item.material for item in read(tmp_path, body).objects] == ["steel", "itu_glass"]


MOVING = """def Xform "car" {
      double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 12: (0, 0, 600), 24: (0, 0, 0) }
      uniform token[] xformOpOrder = ["xformOp:translate"]
      def Mesh "m" {
      CUBE
      }
    }
    def Mesh "house" {
    CUBE
    }""".replace("CUBE", CUBE)


def test_velocity_is_the_first_interval_in_world_metres_per_second(tmp_path: Path) -> None:
    # 600 cm in 12 frames at 24 a second along the stage's z, which is -y with y up turned to z up.
    metadata = 'metersPerUnit = 0.01\n upAxis = "Y"\n timeCodesPerSecond = 24\n startTimeCode = 0\n endTimeCode = 24'
    car, house = read(tmp_path, MOVING, metadata).objects
    assert car.velocity == pytest.approx((0, -12.0, 0), abs=1e-9)
    assert not house.moves
    np.testing.assert_allclose(car.vertices.mean(axis=0), 0, atol=1e-12)


def test_a_start_within_the_animation_takes_its_interval_and_place(tmp_path: Path) -> None:
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 18\n endTimeCode = 24"
    car = read(tmp_path, MOVING, metadata).objects[0]
    assert car.velocity == pytest.approx((0, 0, -1200.0))
    np.testing.assert_allclose(car.vertices.mean(axis=0), [0, 0, 300], atol=1e-9)


def test_a_spinning_wheel_stands_still_and_is_counted(tmp_path: Path) -> None:
    body = f"""def Mesh "wheel" {{
      {CUBE}
      double xformOp:rotateX.timeSamples = {{ 0: 0, 10: 45 }}
      uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }}"""
    scene = read(tmp_path, body)
    assert not scene.objects[0].moves
    assert any(warning.startswith("1 objects turn") for warning in scene.warnings)


def test_point_instances_move(tmp_path: Path) -> None:
    body = f"""def PointInstancer "birds" {{
      point3f[] positions.timeSamples = {{ 0: [(0, 0, 0), (9, 0, 0)], 24: [(3, 0, 0), (9, 0, 4)] }}
      int[] protoIndices = [0, 0]
      rel prototypes = </birds/bird>
      def Mesh "bird" {{
      {CUBE}
      }}
    }}"""
    objects = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").objects
    np.testing.assert_allclose([item.velocity for item in objects], [[3, 0, 0], [0, 0, 4]], atol=1e-9)


def test_the_velocity_attribute_goes_to_all_below_and_turns_with_the_axes(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      custom float3 radar:velocity = (1, 2, 3)
      def Mesh "m" {{
      {CUBE}
      }}
    }}"""
    item = read(tmp_path, body, 'metersPerUnit = 0.01\n upAxis = "Y"').objects[0]
    assert item.velocity == pytest.approx((1, -3, 2))  # metres per second whatever the stage's unit


def test_a_cross_section_makes_a_point_target_of_the_whole_subtree(tmp_path: Path) -> None:
    body = f"""def Xform "pedestrian" {{
      custom float radar:rcs_dbsm = -1.5
      double3 xformOp:translate.timeSamples = {{ 0: (4, 0, 1), 24: (4, 2, 1) }}
      uniform token[] xformOpOrder = ["xformOp:translate"]
      def Mesh "body" {{
      {CUBE}
      }}
    }}
    def Mesh "wall" {{
    {CUBE}
    }}"""
    scene = read(tmp_path, body)
    assert [item.name for item in scene.objects] == ["/wall"]
    (target,) = scene.targets
    assert (target.name, target.rcs_dbsm) == ("/pedestrian", -1.5)
    assert target.position == pytest.approx((4, 0, 1))
    assert target.velocity == pytest.approx((0, 2, 0))
    assert any("1 geometry prims left out" in warning for warning in scene.warnings)


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("radar:rcs_dbsm", "custom string radar:rcs_dbsm = 'ten'"),
        ("radar:rcs_dbsm", "custom float radar:rcs_dbsm = nan"),
        ("radar:velocity", "custom float radar:velocity = 3"),
        ("radar:velocity", "custom double3 radar:velocity = (inf, 0, 0)"),
        ("radar:material", "custom float radar:material = 3"),
    ],
)
def test_an_unusable_radar_attribute_is_named(tmp_path: Path, attribute: str, value: str) -> None:
    with pytest.raises(InputError, match=rf"stage\.usda: /m\.{attribute} = .*; expected ") as caught:
        read(tmp_path, f'def Mesh "m" {{\n{CUBE}\n{value}\n}}')
    assert "\n" not in str(caught.value)


def test_what_is_not_to_be_seen_is_left_out_and_counted(tmp_path: Path) -> None:
    body = f"""def Xform "hidden" {{
      token visibility = "invisible"
      def Mesh "m" {{
      {CUBE}
      }}
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
    stage(tmp_path, 'def Xform "A" {\ndef Mesh "m" (references = @gone.usda@</X>) {\n}\n}', name="inner.usda")
    with pytest.raises(InputError, match=r"stage\.usda: .*gone\.usda.*</[aA]") as caught:
        read(tmp_path, f'{body}\ndef Cube "c" {{\n}}')
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_missing_sublayer_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.usda"):
        read(tmp_path, 'def Cube "c" {\n}', f"{METRES_Z_UP}\n subLayers = [@gone.usda@]")


@pytest.mark.parametrize(
    "metadata", ["metersPerUnit = 0", "metersPerUnit = -1", 'upAxis = "X"', "timeCodesPerSecond = 0"]
)
def test_impossible_metadata_is_named(tmp_path: Path, metadata: str) -> None:
    with pytest.raises(InputError, match=metadata.split()[0]):
        read(tmp_path, 'def Cube "c" {\n}', metadata)


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


def test_layers_in_other_units_are_told_with_the_size_they_give(tmp_path: Path) -> None:
    stage(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', 'metersPerUnit = 0.01\n upAxis = "Y"', name="inner.usda")
    scene = read(tmp_path, 'def "a" (references = @inner.usda@</m>) {\n}')
    assert any("1 layers are in units of 0.01 m within a stage of 1 m" in warning for warning in scene.warnings)
    assert any("1 layers have Y up within a stage with Z up" in warning for warning in scene.warnings)
    assert any("the scene measures 2 x 2 x 2 m" in warning for warning in scene.warnings)


def test_the_same_file_gives_the_same_scene(tmp_path: Path) -> None:
    path = stage(tmp_path, MOVING + '\ndef Xform "l" (references = </l>) {\n}')  # a cycle: USD names layers by address
    first, second = read_usd(path), read_usd(path)
    assert first.content_hash() == second.content_hash()
    assert first.warnings == second.warnings
    assert any("composition errors" in warning and "anon:" not in warning for warning in first.warnings)


@needs_reference
def test_every_reference_stage_is_a_scene_or_one_line() -> None:
    read_count = refused = 0
    for path in sorted(REFERENCE.rglob("*.usd*")):
        try:
            scene = open_scene(str(path))
        except InputError:
            refused += 1
            continue
        read_count += 1
        names = [item.name for item in (*scene.objects, *scene.targets)]
        assert len(set(names)) == len(names)
        assert np.isfinite(scene.bounds()).all()
    # Nine files of materials alone, six that refer to a file kept elsewhere, one mesh without points.
    assert (read_count, refused) == (52, 16)


@needs_reference
def test_reference_sizes_and_motion() -> None:
    blocks = open_scene(str(REFERENCE / "McUsd" / "McUsd.usda"))  # 13 x 13 blocks of 1 m, in centimetres, y up
    np.testing.assert_allclose(np.subtract(*blocks.bounds()[::-1])[:2], [13, 13], atol=1e-5)
    box = {item.material: item for item in open_scene(str(REFERENCE / "BoxAnimated.usdz")).objects}
    assert box["inner"].velocity == pytest.approx((0, 0, 2.52 / 30 * 24), abs=1e-6)
    assert not box["outer"].moves
    man = open_scene(str(REFERENCE / "CesiumMan.usdz"))
    assert man.bounds()[1][2] == pytest.approx(1.5, abs=0.05)  # upright, in metres
    assert "1 skinned meshes taken in their rest pose" in man.warnings


@needs_reference
def test_a_sedan_of_466_metres_is_told() -> None:
    folder = REFERENCE / "Vehicles" / "USD_Mini_Car_Kit" / "assets" / "vehicles" / "sedan"
    scene = open_scene(str(folder / "asset" / "sedanBodyAsset.usda"))
    assert any("467 x" in warning or "x 467 x" in warning for warning in scene.warnings)
    assert {item.material for item in scene.objects} >= {"redMaterial", "windowMaterial"}


@needs_reference
def test_a_reference_matrix_with_its_missing_layer_put_in_place(tmp_path: Path) -> None:
    """The file refers to ../../../_common/axis.usda, which the collection keeps elsewhere."""
    deep = tmp_path / "a" / "b" / "c"
    deep.mkdir(parents=True)
    (tmp_path / "_common").mkdir()
    (tmp_path / "_common" / "axis.usda").write_text('#usda 1.0\n(\n defaultPrim = "x"\n)\ndef Scope "x" {\n}\n')
    shutil.copy(REFERENCE / "transforms" / "weird_matrix_transform.usda", deep / "stage.usda")
    item = open_scene(str(deep / "stage.usda")).objects[0]
    # Row vectors: the cube's centre goes to the matrix's last row (13, 14, 15) cm, y up.
    np.testing.assert_allclose(item.vertices.mean(axis=0), [0.13, -0.15, 0.14], atol=1e-12)
    # x row (1, 2, 3), y row (5, 6, 7), z row (9, 10, 11) span 15 = 1 + 5 + 9 in x.
    assert np.ptp(item.vertices[:, 0]) == pytest.approx(0.15)
