"""Every reader of the data factory on damaged and odd files: finite values, or one line. Anything else fails the test.

What is read must be finite: a NaN that a reader lets through is found much later, by somebody else. Good files are
damaged by splices of bytes that parsers trip over, and by edits after which most of them can still be parsed. The
examples are the same in every run and bounded in number; ``FUZZ_INPUTS`` lets them go on (``tests/fuzzing.py``).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import trimesh
from fuzzing import EDITS, JSON, SPLICES, Edit, Splice, altered, damaged, edited, fuzz, reads_or_says_one_line
from hypothesis import strategies as st

from datafactory.frame.points import read_targets
from datafactory.paths.storage import TracedFrame, paths_schema, read_paths, to_row, writer_options
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.run.shards import write_shard, write_tables
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset import VERSION, Frame, arrow_schema, description
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import read_frames
from shared.radar import ImageGrid, Radar, load_radar
from shared.radar.waveform import Waveform

RADAR = b"""name = "fuzz"
[waveform]
carrier_hz = 76.5e9
bandwidth_hz = 4e8
chirp_interval_s = 0.2e-3
chirps = 16
samples = 64
range_bins = 60
multiplexing = "tdm"
[array]
tx_m = [[0.0, 0.0, 0.0], [0.0, 0.01, 0.0]]
rx_m = [[0.0, 0.0, 0.0], [0.0, 0.002, 0.0]]
[front_end]
noise_figure_db = 10
tx_pattern = { kind = "isotropic", gain_dbi = 3.0 }
[grid]
bins = 20
u_start = -0.5
"""

MATERIALS = b"""default = "metal"
[map]
"wall 1" = "snow"
[material.snow]
relative_permittivity = 1.5
conductivity = 0.01
sigma0_db = -20.0
grazing_deg = 10.0
pattern = "backscattering"
valid_ghz = [70.0, 80.0]
aliases = ["ice", "drift"]
"""

POSES = b"""[{"position": [1, 2.5, 0.5], "yaw_deg": 30, "pitch_deg": -2e0, "velocity": [3, 0, 0], "time": 0.5},
 {"position": [0, 0, 1]}]"""

TARGETS = b"""[[{"x": 10, "y": -2.5, "z": 0.1, "vx": 3, "rcs_dbsm": 5.0, "phase": 1e-3}], [],
 [{"x": 4, "y": 0, "rcs_dbsm": -10}],
 [{"x": 9, "y": 1, "z": -0.5, "vx": -1.4, "model": "pedestrian", "stature_m": 1.75, "gait_phase": 0.5},
  {"x": 20, "y": 3, "vx": 9, "model": "car", "wheel_radius_m": 0.3, "heading_deg": 2e1}]]"""


PATTERN = b"""azimuth_deg,elevation_deg,gain_dbi
-180,-90,0
-180,90,1.5
180,-90,-3
180,90,2e0
"""


USD = b"""#usda 1.0
(
  metersPerUnit = 0.01
  upAxis = "Y"
  timeCodesPerSecond = 24
  startTimeCode = 0
  endTimeCode = 24
)
def Xform "car" (
  kind = "component"
)
{
  custom double3 radar:velocity = (1, 0, 2)
  double3 xformOp:translate.timeSamples = { 0: (0, 1, 2), 24: (100, 1, 2) }
  float3 xformOp:rotateXYZ = (10, 20, 30)
  uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
  def Mesh "body"
  {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
    int[] faceVertexCounts = [4, 3, 3]
    int[] faceVertexIndices = [0, 1, 2, 3, 0, 1, 4, 1, 2, 4]
    uniform token subdivisionScheme = "none"
    custom string radar:material = "metal"
    def GeomSubset "front" {
      uniform token elementType = "face"
      int[] indices = [1]
    }
  }
  def Sphere "wheel" {
    double radius = 30
  }
  def Xform "sign" {
    custom double radar:rcs_dbsm = 5
  }
  def Xform "walker" {
    custom string radar:target = "pedestrian"
    custom float radar:stature_m = 1.75
    custom double3 radar:velocity = (1.4, 0, 0)
  }
}
def Xform "crane" {
  float3 xformOp:rotateXYZ.timeSamples = { 0: (10, 20, 30), 7.5: (90, 0, 0), 24: None, 48: (0, 0, 360) }
  float3 xformOp:scale.timeSamples = { 0: (1, 1, 1), 24: (2, 1, 1) }
  double xformOp:translateX.spline = {
    0: 0; post linear,
    24: 6; post held,
    48: 10; post curve,
  }
  quatf xformOp:orient.timeSamples = { 0: (1, 0, 0, 0), 24: (0.5, 0.5, 0.5, 0.5) }
  matrix4d xformOp:transform:own.timeSamples = {
    0: ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) ),
    24: ( (0, 1, 0, 0), (1, 0, 0, 0), (0, 0, 1, 0), (0, 0, 9, 1) ),
  }
  uniform token[] xformOpOrder = ["xformOp:translateX", "xformOp:rotateXYZ", "xformOp:scale", "xformOp:orient",
    "!invert!xformOp:scale", "xformOp:transform:own"]
  def Mesh "flag" {
    point3f[] points.timeSamples = {
      0: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
      12: [(0, 0, 0), (1, 0, 1), (1, 1, 2), (0, 1, 0)],
    }
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    token visibility.timeSamples = { 0: "inherited", 24: "invisible" }
  }
  def Xform "lamp" {
    custom token radar:target = "sphere"
    custom double radar:radius_m = 0.1
  }
}
def PointInstancer "birds" {
  rel prototypes = [</birds/bird>]
  int[] protoIndices = [0, 0]
  point3f[] positions.timeSamples = { 0: [(0, 0, 0), (200, 0, 0)], 24: [(0, 9, 0), (200, 0, 9)] }
  quath[] orientations.timeSamples = { 0: [(1, 0, 0, 0), (1, 0, 0, 0)], 24: [(0, 1, 0, 0), (0, 0, 0, 1)] }
  def Cube "bird" {
    double size.timeSamples = { 0: 1, 24: 2 }
    double xformOp:rotateZ.timeSamples = { 0: 0, 24: 90 }
    uniform token[] xformOpOrder = ["xformOp:rotateZ"]
  }
}
def PointInstancer "poles" {
  rel prototypes = [</poles/pole>]
  int[] protoIndices = [0, 0]
  point3f[] positions = [(0, 0, 0), (200, 0, 0)]
  def Cylinder "pole" {
    double radius = 5
    double height = 300
  }
}
"""

XML = b"""<scene version="2.1.0">
  <default name="far" value="30"/>
  <bsdf type="itu-radio-material" id="mat-concrete"><string name="type" value="concrete"/></bsdf>
  <shape type="ply" id="part"><string name="filename" value="part.ply"/><ref id="mat-concrete"/></shape>
  <shape type="cube" id="box"><transform name="to_world"><scale value="2"/><rotate z="1" angle="30"/>
    <translate x="$far" y="1"/><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
  <shape type="sphere"><float name="radius" value="0.5"/><point name="center" x="1" y="2" z="3"/></shape>
  <shape type="cylinder"><point name="p0" value="0 0 0"/><point name="p1" x="1"/></shape>
  <shape type="rectangle"><boolean name="flip_normals" value="true"/><transform name="to_world">
    <lookat origin="0, 0, 0" target="1, 0, 0" up="0, 0, 1"/></transform></shape>
</scene>
"""


INNER = b"""<scene version="2.1.0"><default name="size" value="2"/>
  <shape type="obj"><string name="filename" value="part.obj"/><boolean name="flip_normals" value="true"/></shape>
  <shape type="cube"><transform name="to_world"><scale value="$size"/></transform></shape>
</scene>
"""

OBJ = b"""mtllib none.mtl
o part
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0.5
usemtl metal
f 1 2 3
f 1//1 3//1 4//1
g other
f -1 -2 -3 -4
"""

PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 1
3 0 1 2
3 0 2 3
"""

STL = b"""solid part
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid part
"""


def finite_radar(path: Path) -> None:
    radar = load_radar(str(path))
    json.dumps(radar.metadata(), allow_nan=False)


def finite_poses(path: Path) -> None:
    for pose in read_poses(path):
        assert np.isfinite([*pose.position, *pose.velocity, *pose.quaternion(), pose.time_s]).all()


def finite_targets(path: Path) -> None:
    for frame in read_targets(path):
        placed = frame.echo_points(Radar(), 1)
        for values in (placed.position, placed.velocity, placed.rcs_dbsm, placed.phase_rad):
            assert np.isfinite(values).all()


def finite_materials(path: Path) -> None:
    table = load_materials(path)
    json.dumps(table.map_materials(["wall 1", "", "\x00"]).to_json(), allow_nan=False)


def finite_pattern(path: Path) -> None:
    radar = path.with_name("with-pattern.toml")
    radar.write_text(f'[front_end]\nrx_pattern = {{ kind = "table", file = "{path.name}" }}\n')
    finite_radar(radar)


TIMES_S = (-1.0, 0.0, 0.3, 1.0, 50.0)
"""Times at which what moves is looked at: before, at, between, at and after its samples."""


def finite_scene(path: Path) -> Scene:
    scene = open_scene(str(path))
    lower, upper = scene.bounds()
    assert np.isfinite([lower, upper]).all()
    for item in scene.objects:
        assert np.isfinite(item.vertices).all()
        assert np.isfinite(item.velocity).all()
        assert item.triangles.min() >= 0
        assert item.triangles.max() < len(item.vertices)
        for time in TIMES_S if item.moves else ():
            now = item.at(time)
            assert np.isfinite([now.vertices, now.velocities]).all()
    for target in scene.targets:
        for there in (target, *(target.at(time) for time in TIMES_S)):
            assert np.isfinite([*there.position, *there.velocity, *there.spin, there.rcs_dbsm]).all()
    return scene


def finite_part(path: Path) -> None:
    """A scene that is a part of another."""
    outer = path.with_name("outer.xml")
    outer.write_text('<scene version="2.1.0"><include filename="inner.xml"/></scene>')
    finite_scene(outer)


TEXTS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "radar.toml": (RADAR, finite_radar),
    "materials.toml": (MATERIALS, finite_materials),
    "poses.json": (POSES, finite_poses),
    "targets.json": (TARGETS, finite_targets),
    "pattern.csv": (PATTERN, finite_pattern),
    "scene.usda": (USD, finite_scene),
    "scene.xml": (XML, finite_scene),
    "inner.xml": (INNER, finite_part),
    "scene.obj": (OBJ, finite_scene),
    "scene.ply": (PLY, finite_scene),
    "scene.stl": (STL, finite_scene),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds the parts that the scenes refer to."""
    made = tmp_path_factory.mktemp("fuzz")
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.export(made / "part.ply")
    box.export(made / "part.obj")
    return made


def read_text(folder: Path, name: str, content: bytes) -> None:
    (folder / name).write_bytes(content)
    TEXTS[name][1](folder / name)


@pytest.mark.parametrize("name", TEXTS)
def test_the_undamaged_text_is_read(folder: Path, name: str) -> None:
    read_text(folder, name, TEXTS[name][0])


@pytest.mark.parametrize("name", TEXTS)
@fuzz(120, splices=SPLICES)
def test_damaged_text(folder: Path, name: str, splices: list[Splice]) -> None:
    reads_or_says_one_line(lambda: read_text(folder, name, damaged(TEXTS[name][0], splices)))


@pytest.mark.parametrize("name", TEXTS)
@fuzz(120, edits=EDITS)
def test_edited_text(folder: Path, name: str, edits: list[Edit]) -> None:
    reads_or_says_one_line(lambda: read_text(folder, name, edited(TEXTS[name][0], edits)))


@pytest.mark.parametrize("name", ["poses.json", "targets.json"])
@fuzz(80, edits=st.lists(st.tuples(st.floats(0.0, 1.0), JSON), min_size=1, max_size=3))
def test_altered_documents(folder: Path, name: str, edits: list[tuple[float, object]]) -> None:
    """Of the right syntax and the wrong content."""
    document = json.dumps(altered(json.loads(TEXTS[name][0]), edits))
    reads_or_says_one_line(lambda: read_text(folder, name, document.encode()))


@pytest.fixture(scope="module")
def binaries(folder: Path) -> Path:
    """Folder of files ``whole.*``: crate and package of the USD stage above, meshes in every format."""
    from pxr import Usd, UsdUtils

    (folder / "whole.usda").write_bytes(USD)
    Usd.Stage.Open(str(folder / "whole.usda")).Export(str(folder / "whole.usdc"))
    UsdUtils.CreateNewUsdzPackage(str(folder / "whole.usdc"), str(folder / "whole.usdz"))
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    for suffix in ("ply", "stl", "obj", "glb"):
        box.export(folder / f"whole.{suffix}")
    return folder


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".glb"])
@fuzz(120, splices=SPLICES)
def test_damaged_mesh_file(binaries: Path, suffix: str, splices: list[Splice]) -> None:
    path = binaries / f"damaged{suffix}"
    path.write_bytes(damaged((binaries / f"whole{suffix}").read_bytes(), splices))
    reads_or_says_one_line(lambda: finite_scene(path))


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
@fuzz(12, splices=SPLICES)  # a quarter of a second each, most of it in the operating system
def test_damaged_binary_usd(binaries: Path, suffix: str, splices: list[Splice]) -> None:
    path = binaries / f"damaged{suffix}"
    path.write_bytes(damaged((binaries / f"whole{suffix}").read_bytes(), splices))
    reads_or_says_one_line(lambda: finite_scene(path))


@pytest.fixture(scope="module")
def gltf() -> tuple[dict[str, Any], bytes]:
    """The header and the data of a glTF file: two nodes, one within the other, with a material and an animation."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name="metal"))
    scene = trimesh.Scene()
    scene.add_geometry(box, node_name="outer")
    turned = trimesh.transformations.rotation_matrix(0.3, [0, 0, 1])
    scene.add_geometry(box, node_name="inner", parent_node_name="outer", transform=turned)
    whole = scene.export(file_type="glb")
    length = int.from_bytes(whole[12:16], "little")
    header = json.loads(whole[20 : 20 + length])
    return header | {"animations": [{}], "skins": []}, whole[20 + length + 8 :]


@fuzz(200, edits=st.lists(st.tuples(st.floats(0.0, 1.0), JSON | st.integers(-2, 9)), min_size=0, max_size=4))
def test_a_gltf_with_an_altered_header(
    folder: Path, gltf: tuple[dict[str, Any], bytes], edits: list[tuple[float, Any]]
) -> None:
    header, data = gltf
    text = json.dumps(altered(header, edits)).encode()
    text += b" " * (-len(text) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(data).to_bytes(4, "little") + b"BIN\x00" + data
    path = folder / "altered.glb"
    path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks)
    reads_or_says_one_line(lambda: finite_scene(path))


def small_radar() -> Radar:
    return Radar(waveform=Waveform(samples=4, range_bins=3, chirps=2), grid=ImageGrid(bins=5))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    """A dataset of two frames in one shard, and a shard of traced paths."""
    made = tmp_path_factory.mktemp("dataset")
    radar = small_radar()
    frames = [
        Frame(
            index, "points", "points", index, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
            np.ones((3, 3, 48), np.complex64), np.zeros((3, 3), np.float32), np.ones((3, 5), np.float32), 1.0, 0.5,
        )
        for index in range(2)
    ]  # fmt: skip
    about = description(radar, 3, "range-channel")
    record = write_shard(made / "train" / "part-00000.parquet", frames, arrow_schema(about))
    manifest = {"version": VERSION, "shards": [record.model_dump()], "made": {}}
    (made / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
    points = ScatteredPaths.of_points(np.ones((2, 3)), np.zeros((2, 3)), np.ones(2))
    traced = TracedFrame(0, "scene", 0, 1, Pose((0.0, 0.0, 0.0)), 0.0039, 0, PathTable(points, objects=("a",)))
    rows = [pa.Table.from_pylist([to_row(traced)], schema=paths_schema())]
    write_tables(made / "paths" / "part-00000.parquet", rows, paths_schema(), **writer_options())
    return made


@fuzz(120, splices=SPLICES)
def test_damaged_shard(dataset: Path, splices: list[Splice]) -> None:
    path = dataset / "damaged.parquet"
    path.write_bytes(damaged((dataset / "train" / "part-00000.parquet").read_bytes(), splices))
    reads_or_says_one_line(lambda: list(read_frames(path)))


@fuzz(120, splices=SPLICES)
def test_damaged_paths_shard(dataset: Path, splices: list[Splice]) -> None:
    path = dataset / "damaged-paths.parquet"
    path.write_bytes(damaged((dataset / "paths" / "part-00000.parquet").read_bytes(), splices))
    reads_or_says_one_line(lambda: list(read_paths(path)))


@fuzz(100, splices=SPLICES)
def test_damaged_manifest(dataset: Path, splices: list[Splice]) -> None:
    whole = (dataset / MANIFEST).read_bytes()
    try:
        (dataset / MANIFEST).write_bytes(damaged(whole, splices))
        reads_or_says_one_line(lambda: verify(open_dataset(dataset)))
    finally:
        (dataset / MANIFEST).write_bytes(whole)
