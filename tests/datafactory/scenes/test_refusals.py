"""What is wrong in a file or an option is one line; what USD files lack or pass on is made up for."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from usd_files import CUBE, METRES_Z_UP, TWINS, Twin, cube, ops, read, translated, write_usda

from datafactory.frame.points import read_targets
from datafactory.scenes.drives import parse_drives
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.scenes.readers.common import Reading, parse_variants
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.tracks import read_track
from datafactory.scenes.traffic.arrange import parse_populate
from shared.physics.errors import InputError

READERS: dict[str, Callable[[Path], object]] = {
    "poses.json": read_poses, "track.json": read_track, "track.csv": read_track, "targets.json": read_targets,
    "materials.toml": load_materials, "prim.usda": lambda path: open_scene(str(path)),
    "metadata.usda": lambda path: open_scene(str(path)), "scene.xml": lambda path: open_scene(str(path)),
}  # fmt: skip
ROWS = "time,x,y,z,yaw_deg\n0,0,0,0.5,0\n1,4,0,0.5,0\n2,8,0,0.5,90\n4,8,8,0.5,90\n"
HERE, NAMES = '"position": [0, 0, 1]', "time,x,y,z,yaw_deg"
FLAT = "\nfloat3 xformOp:scale = (1, 1, 0)\nuniform token[] xformOpOrder = ['xformOp:scale']"
JUMP = (
    "\ndouble xformOp:translateX.timeSamples = { 0: 0, 1: nan }\nuniform token[] xformOpOrder = ['xformOp:translateX']"
)

FILES: dict[str, list[tuple[str | bytes, str]]] = {
    "poses.json": [
        ("[{", "malformed JSON"),
        ("{}", r"document = \{\}; expected a list, as in \[\{"),
        ("[]", "the list is empty; expected "),
        ("[{}]", r"entry 0\.position missing; expected a value, as in \[\{.position"),
        (f'[{{{HERE}}}, {{"position": [0, 0]}}]', r"entry 1\.position = \[0, 0\]; expected 3 or more entries"),
        ('[{"position": [0, 0, NaN]}]', r"entry 0\.position\.2 = nan; expected a finite number"),
        (f'[{{{HERE}, "yaw": 3}}]', r"unknown field entry 0\.yaw; expected one of position, yaw_deg"),
        (f"[{{{HERE}, {HERE}}}]", "the key 'position' is given twice"),
    ],
    "track.json": [  # beyond what is wrong in a list of poses
        (f"[{{{HERE}}}]", r"entry 0\.time missing; expected a value, as in \[\{"),
        (f'[{{"time": 0, {HERE}}}, {{"time": 0, {HERE}}}]', "entry 1, time = 0 after 0"),
        (f'[{{"time": 0, {HERE}, "velocity": [1, 0, 0]}}, {{"time": 1, {HERE}}}]', "entry 1 has no velocity, others"),
    ],
    "track.csv": [
        ("", r"is empty; expected a line of names, time,x,y,z,yaw_deg\[,pitch_deg\]"),
        ("time,x,y,z\n0,0,0,0\n", "line 1: no column 'yaw_deg'"),
        (f"{NAMES},speed\n", "line 1: column 'speed' unknown; expected some of time, x"),
        ("time,x,x,y,z,yaw_deg\n", "line 1: column 'x' twice"),
        (f"{NAMES},vx\n", "line 1: no column 'vy'"),
        (f"{NAMES}\n0,0,0,0,0\n", "1 pose; expected at least two"),
        (ROWS + "5,1,2,3\n", "line 6 has 4 values; expected 5"),
        (ROWS + "5,a,2,3,4\n", "line 6, x = 'a'; expected a number"),
        (ROWS + "5,1,2,nan,4\n", "line 6, z = 'nan'; expected a finite number"),
        (ROWS + "5,1e10,2,3,4\n", "line 6, x = '1e10'; expected at most 1e\\+09"),
        (ROWS + "4,1,2,3,4\n", "line 6, time = 4 after 4; expected times that rise"),
        (ROWS + "4.000001,9,8,0.5,4\n", r"line 6 is reached at 1e\+06 m/s from the pose before; expected at most"),
        (ROWS + '5,"1,2,3,4\n', "is no table"),
        (b"\xff\xfe\x00t", "is no table"),
    ],
    "targets.json": [
        ('[[{"x": 1.0, "y": 0.0}]]', r"no rcs_dbsm; expected one, or a model, as in a list of frames, each"),
        ('[[{"x": "1.0", "y": 0.0, "rcs_dbsm": 0}]]', r"entry 0\.0\.x = '1\.0'; expected a number, as in"),
        ('[[{"x": 1.0, "y": 0.0, "rcs_dbsm": true}]]', r"entry 0\.0\.rcs_dbsm = True; expected a number, as in"),
        ('[[{"x": 1.0, "y": 0.0, "rcs_dbsm": 500}]]', r"entry 0\.0\.rcs_dbsm = 500; expected at most 200"),
        ('[[{"x": 1.0, "y": 0.0, "model": "car", "rcs_dbsm": 1.0}]]', "a model beside rcs_dbsm"),
        ('[[{"x": 1.0, "y": 0.0, "rcs_dbsm": 1.0, "stature_m": 1.7}]]', "stature_m without a model"),
        ('[[{"x": 1.0, "y": 0.0, "model": "pedestrian", "stature_m": "tall"}]]', "tall"),
        ('[[{"x": 1, "y": 0, "model": "pedestrian", "stature_m": 1.7, "vx": 9}]]', "a walker of 1.7 m at 9 m/s"),
        ('[[{"x": 1.0, "y": 0.0, "model": "car", "sizes": {"wheel_radius_m": 0.3}}]]', "sizes"),
    ],
    "materials.toml": [
        ("[material.brick\n", "malformed TOML"),
        (b"\xff\xfe", "not UTF-8 text"),
        ("[materials.brick]\n", "unknown field materials; expected one of material, map, default"),
        ("[material.brick]\nconductance = 1.0", r"unknown field material\.brick\.conductance; expected one of"),
        ("[material.brick]\nrelative_permittivity = 0.5", r"brick\.relative_permittivity = 0\.5; expected at least 1"),
        ("[material.brick]\nsigma0_db = -20.0", "no roughness; expected scattering_coefficient, or sigma0_db with"),
        ("[material.air]\nsource = 'x'\nrelative_permittivity = 1.0\nconductivity = 0.0\nsigma0_db = -20.0\n"
         "grazing_deg = 5.0", "sigma0_db of what reflects nothing; expected relative_permittivity above 1"),
        ("[material.brick]\nsigma0_db = -15.0\ngrazing_deg = 10.0",
         r"sigma0_db = -15; expected at most -16\.6 at grazing_deg = 10, of a surface that scatters all"),
        ("[material.asphalt]\npattern = 'backscattering'",
         "sigma0_db beside pattern = 'backscattering'; expected scattering_coefficient with it"),
        ("[material.brick]\nvalid_ghz = [90.0, 80.0]", r"valid_ghz = \[90\.0, 80\.0\]; expected"),
        ("[material.brick]\naliases = ['42']", "alias '42' has no letters"),
        ("[material.foam]\nconductivity = 1.0", r"material\.foam\.relative_permittivity missing; expected a value"),
        ("[map]\nwall = 'jelly'", r"map\.wall = 'jelly'; expected one of concrete, brick"),
    ],
    "prim.usda": [
        ("string radar:rcs_dbsm = 'ten'", r"/t\.radar:rcs_dbsm = 'ten'; expected a finite number"),
        ("float radar:rcs_dbsm = 500", r"/t\.radar:rcs_dbsm = 500; expected -200 to 200 dBsm"),
        ("float radar:velocity = 3", r"/t\.radar:velocity = 3\.0; expected three finite numbers"),
        ("double3 radar:velocity = (inf, 0, 0)", r"/t\.radar:velocity = .*; expected three finite numbers"),
        ("float radar:material = 3", r"/t\.radar:material = 3\.0; expected a material name"),
        ("string radar:class = ''", r"/t\.radar:class = ''; expected the name of a class"),
        ("string radar:target = 'lorry'", r"/t\.radar:target = 'lorry'; expected one of car"),
        ("string radar:target = 'car'; float radar:rcs_dbsm = 3", "one of the two"),
        ("float radar:targets_by_name = 1", r"/t\.radar:targets_by_name = 1\.0; expected true or false"),
        (f"string radar:target = 'car'{FLAT}", "its transform is flat"),
        ("string radar:target = 'sphere'", "'sphere' with no sizes; expected radius_m"),
        ("string radar:target = 'sphere'; string radar:radius_m = 'big'", r"/t\.radar:radius_m = 'big'; expected a"),
        ("string radar:target = 'car'; float radar:radius_m = 1", "'car' with radius_m; expected no sizes"),
        ("string radar:target = 'trihedral'; float radar:edge_m = 0", r"edge_m = 0\.0; expected more than 0"),
        ("string radar:target = 'car'; bool radar:wheel_radius_m = 1", "radar:wheel_radius_m = True"),
        ("string radar:target = 'car'; float radar:wheel_radius_m = 3", r"wheel_radius_m = 3\.0; expected 0\.1 to 1"),
        ("string radar:target = 'pedestrian'; double radar:gait_phase = 1.5", r"gait_phase = 1\.5; expected 0 to 1"),
        (
            "string radar:target = 'pedestrian'; float radar:stature_m = 1.7; double3 radar:velocity = (3, 0, 0)",
            r"/t: a walker of 1\.7 m at 3 m/s; expected at most 2\.5 m/s",
        ),
        (f"string radar:class = 'car'{JUMP}", r"/t/m moves at \(nan, nan, nan\) m/s; expected at most"),
    ],
    "metadata.usda": [
        ("metersPerUnit = 0", "metersPerUnit = 0"),
        ('upAxis = "W"', "upAxis = 'W'; expected X, Y or Z"),
        ("timeCodesPerSecond = 0", "timeCodesPerSecond = 0"),
        ("startTimeCode = nan", "startTimeCode = nan"),
        ("subLayers = [@gone.usda@]", r"gone\.usda"),
    ],
    "scene.xml": [
        ('<shape type="ply" id="a"><string name="filename" value="gone.ply"/></shape>', "shape 'a': mesh file .*gone"),
        ('<shape type="ply" id="a"><string name="filename" value="torn.ply"/></shape>', "torn.ply.* cannot be read"),
        ('<shape type="ply" id="a"/>', "shape 'a': no filename"),
        ('<shape type="cube" id="a"><ref id="mat-gone"/></shape>', "mat-gone"),
        ('<shape type="cube" id="a"/><shape type="cube" id="a"/>', "id 'a' is used twice"),
        ('<shape type="sphere" id="a"><float name="radius" value="-1"/></shape>', "radius = -1; expected a positive"),
        ('<shape type="sphere" id="a"><string name="radius" value="x"/></shape>', "radius = 'x' is a <string>"),
        ('<shape type="cube" id="a"><string name="to_world" value="x"/></shape>', "to_world = 'x'"),
        ('<shape type="cube"><transform name="to_world"><scale x="nan"/></transform></shape>', "to_world has <scale x"),
        ('<shape type="cube"><transform name="to_world"><twist x="1"/></transform></shape>', "to_world has <twist x"),
        ('<shape type="cube"', "not well-formed XML"),
        ('<include filename="scene.xml"/>', "nested more than 15 deep"),
        ('<shape type="ply"><string name="filename" value="$name"/></shape>', "undefined parameter"),
    ],
}  # fmt: skip


def content(name: str, text: str) -> str:
    """A whole file of what is wrong in it."""
    if name == "prim.usda":
        attributes = f"custom {text}".replace("; ", "\ncustom ")
        body = f'def Xform "t" {{\n{attributes}\ndef Mesh "m" {{\n{CUBE}\n}}\n}}'
        return f"#usda 1.0\n(\n{METRES_Z_UP}\n timeCodesPerSecond = 1\n)\n{body}\n"
    if name == "metadata.usda":
        return f'#usda 1.0\n(\n{text}\n)\ndef Cube "c" {{\n}}\n'
    return f'<scene version="2.1.0">{text}</scene>' if name == "scene.xml" else text


@pytest.mark.parametrize(("name", "text", "message"), [(name, *row) for name, rows in FILES.items() for row in rows])
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    (tmp_path / "torn.ply").write_bytes(trimesh.creation.box().export(file_type="ply")[:300])
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else content(name, text).encode())
    with pytest.raises(InputError, match=message) as caught:
        READERS[name](path)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["poses.json", "track.csv", "materials.toml"])
def test_a_file_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: cannot be read: No such file"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (parse_drives, "walk", r"--trajectory: 'walk'; expected a file, or drive\[:speed=M/S\]\[,seconds=S\]"),
        (parse_drives, "drive:sped=3", r"'sped=3' in 'drive:sped=3'"),
        (parse_drives, "drive:speed=3,speed=4", r"'speed=4' in"),
        (parse_drives, "drive:speed=fast", r"speed = 'fast'; expected a number"),
        (parse_drives, "drive:speed=101", r"speed = 101.0; expected 0 to 100 m/s"),
        (parse_drives, "drive:seconds=0", r"seconds = 0.0; expected more than 0"),
        (parse_drives, "drive:seconds=0.01", r"0.01 s at 10 Hz are 0 frames"),
        (parse_populate, "cras=3", r"unknown kind 'cras'; expected one of cars, trucks.*did you mean 'cars'\?"),
        (parse_populate, "cars=-3", "cars=-3; expected a whole number from 0 to 2000"),
        (parse_populate, "cars=many/100m", "cars=many/100m; expected from 0 to 100 a hundred metres of road"),
        (parse_populate, "cars=1,cars=2/100m", "cars is given twice"),
        (parse_populate, "parked=0.4/100m", r"parked=0\.4/100m; expected a share"),
        (parse_populate, "cars=2.5", r"cars=2\.5; expected a whole number"),
        (parse_populate, "cars", "cars without a number"),
        (parse_populate, "parked=1.5", r"parked=1\.5; expected a share of the kerb from 0 to 1"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(parse: Callable[..., object], text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse(text, None) if parse is parse_drives else parse(text)
    assert "\n" not in str(caught.value)


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


@pytest.mark.parametrize("specifier", ["over", "class"])
def test_variants_within_a_prototype_are_selected(tmp_path: Path, specifier: str) -> None:
    write_usda(tmp_path, CAR, METRES_Z_UP, "car.usda")
    body = f"""def PointInstancer "lot" {{
      point3f[] positions = [(0, 0, 0)]
      int[] protoIndices = [0]
      rel prototypes = </Kinds/car>
    }}
    {specifier} "Kinds" {{
      def Xform "car" (references = @car.usda@</car>) {{
      }}
    }}"""
    assert names(tmp_path, body) == ["/lot[0]/car/van"]
    assert names(tmp_path, body, "body=sedan") == ["/lot[0]/car/sedan"]


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
