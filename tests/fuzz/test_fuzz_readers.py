"""Every reader on damaged input: it reads, or says one line. Anything else that it raises fails the test.

Good files are damaged by splices of bytes that parsers trip over; JSON and TOML also get documents of the right syntax
and the wrong content. The examples are the same in every run (see ``tests/conftest.py``) and bounded in number. What is
read must be finite: a NaN that a reader lets through is found much later, by somebody else.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from datafactory.frame.points import read_targets
from datafactory.paths.storage import TracedFrame, paths_schema, read_paths, to_row
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.run.shards import write_shard, write_tables
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset import VERSION, Frame, arrow_schema, description
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import read_frames
from shared.physics.errors import InputError
from shared.radar import ImageGrid, Radar, load_radar
from shared.radar.waveform import Waveform

TOKENS = (
    *(b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-320", b"99999999999999999999", b"null", b"true", b"None"),
    *(b"[", b"]", b"{", b"}", b"(", b")", b"<", b">", b'"', b"'", b"\\", b"=", b",", b"#", b"@", b"$x", b"&amp;"),
    *(b"\n", b"\r", b"\x00", b"\xff", b"\xc3\x28", b"\xef\xbb\xbf", "\u0131\u202e".encode(), b"\x1b[31m", b" " * 40),
)

Splice = tuple[float, int, bytes]
SPLICES = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 24), st.one_of(st.sampled_from(TOKENS), st.binary(max_size=4))),
    min_size=1,
    max_size=6,
)
"""(where, as a share of the file; bytes taken out; bytes put in)."""

JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-(10**25), 10**25) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


def damaged(good: bytes, splices: list[Splice]) -> bytes:
    for where, out, put in splices:
        place = int(where * len(good))
        good = good[:place] + put + good[place + out :]
    return good


def bounded(examples: int) -> settings:
    return settings(max_examples=examples, suppress_health_check=list(HealthCheck))


def reads_or_says_one_line(read: Callable[[], object]) -> None:
    try:
        read()
    except InputError as error:
        said = str(error)
    else:
        return
    assert len(said.splitlines()) == 1


def finite_scene(path: Path) -> Scene:
    scene = open_scene(str(path))
    lower, upper = scene.bounds()
    assert np.isfinite([lower, upper]).all()
    for item in scene.objects:
        assert np.isfinite(item.vertices).all()
        assert np.isfinite(item.velocity).all()
        assert item.triangles.min() >= 0
        assert item.triangles.max() < len(item.vertices)
    for target in scene.targets:
        assert np.isfinite([*target.position, *target.velocity, target.rcs_dbsm]).all()
    return scene


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
 [{"x": 4, "y": 0, "rcs_dbsm": -10}]]"""


def finite_radar(path: Path) -> None:
    radar = load_radar(str(path))
    json.dumps(radar.metadata(), allow_nan=False)


def finite_poses(path: Path) -> None:
    for pose in read_poses(path):
        assert np.isfinite([*pose.position, *pose.velocity, *pose.quaternion(), pose.time_s]).all()


def finite_targets(path: Path) -> None:
    for frame in read_targets(path):
        assert all(np.isfinite(values).all() for values in vars(frame).values())


def finite_materials(path: Path) -> None:
    table = load_materials(path)
    json.dumps(table.map_materials(["wall 1", "", "\x00"]).to_json(), allow_nan=False)


TEXTS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "scene.usda": (USD, finite_scene),
    "scene.xml": (XML, finite_scene),
    "radar.toml": (RADAR, finite_radar),
    "materials.toml": (MATERIALS, finite_materials),
    "poses.json": (POSES, finite_poses),
    "targets.json": (TARGETS, finite_targets),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("fuzz")
    trimesh.creation.box((1.0, 2.0, 3.0)).export(made / "part.ply")
    return made


@pytest.mark.parametrize("name", TEXTS)
def test_the_undamaged_text_is_read(folder: Path, name: str) -> None:
    good, read = TEXTS[name]
    (folder / name).write_bytes(good)
    read(folder / name)


@pytest.mark.parametrize("name", TEXTS)
@bounded(120)
@given(splices=SPLICES)
def test_damaged_text(folder: Path, name: str, splices: list[Splice]) -> None:
    good, read = TEXTS[name]
    (folder / name).write_bytes(damaged(good, splices))
    reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", ["poses.json", "targets.json"])
@bounded(80)
@given(field=st.sampled_from(["position", "velocity", "yaw_deg", "time", "x", "vy", "rcs_dbsm", "phase"]), value=JSON)
def test_json_of_the_wrong_content(folder: Path, name: str, field: str, value: object) -> None:
    entry = {"position": [0, 0, 0]} if name == "poses.json" else {"x": 1, "y": 2, "rcs_dbsm": 0}
    entries = [{**entry, field: value}]
    read = TEXTS[name][1]
    for document in (entries if name == "poses.json" else [entries], value):
        (folder / name).write_text(json.dumps(document), encoding="utf-8")
        reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", ["radar.toml", "materials.toml"])
@bounded(80)
@given(
    field=st.sampled_from(
        [
            *("waveform.samples", "waveform.carrier_hz", "waveform", "array.tx_m", "grid.bins", "front_end.rx_pattern"),
            *("material.snow.pattern", "material.snow.valid_ghz", "material.snow.conductivity", "map.x", "default"),
        ]
    ),
    value=st.one_of(
        *(st.floats(), st.integers(-(2**70), 2**70), st.booleans(), st.lists(st.floats(), max_size=3)),
        st.sampled_from(["metal", "", "isotropic"]),
    ),
)
def test_toml_of_the_wrong_content(folder: Path, name: str, field: str, value: object) -> None:
    text = "nan" if value != value else str(value).lower() if isinstance(value, bool) else repr(value)
    (folder / name).write_text(f"{field} = {text}\n", encoding="utf-8")
    reads_or_says_one_line(lambda: TEXTS[name][1](folder / name))


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
@bounded(120)
@given(splices=SPLICES)
def test_damaged_mesh_file(binaries: Path, suffix: str, splices: list[Splice]) -> None:
    path = binaries / f"damaged{suffix}"
    path.write_bytes(damaged((binaries / f"whole{suffix}").read_bytes(), splices))
    reads_or_says_one_line(lambda: finite_scene(path))


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
@bounded(12)  # a quarter of a second each, most of it in the operating system
@given(splices=SPLICES)
def test_damaged_binary_usd(binaries: Path, suffix: str, splices: list[Splice]) -> None:
    path = binaries / f"damaged{suffix}"
    path.write_bytes(damaged((binaries / f"whole{suffix}").read_bytes(), splices))
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
    write_tables(made / "paths" / "part-00000.parquet", rows, paths_schema(), compression="zstd")
    return made


@bounded(120)
@given(splices=SPLICES)
def test_damaged_shard(dataset: Path, splices: list[Splice]) -> None:
    path = dataset / "damaged.parquet"
    path.write_bytes(damaged((dataset / "train" / "part-00000.parquet").read_bytes(), splices))
    reads_or_says_one_line(lambda: list(read_frames(path)))


@bounded(120)
@given(splices=SPLICES)
def test_damaged_paths_shard(dataset: Path, splices: list[Splice]) -> None:
    path = dataset / "damaged-paths.parquet"
    path.write_bytes(damaged((dataset / "paths" / "part-00000.parquet").read_bytes(), splices))
    reads_or_says_one_line(lambda: list(read_paths(path)))


@bounded(100)
@given(splices=SPLICES)
def test_damaged_manifest(dataset: Path, splices: list[Splice]) -> None:
    whole = (dataset / MANIFEST).read_bytes()
    try:
        (dataset / MANIFEST).write_bytes(damaged(whole, splices))
        reads_or_says_one_line(lambda: verify(open_dataset(dataset)))
    finally:
        (dataset / MANIFEST).write_bytes(whole)
