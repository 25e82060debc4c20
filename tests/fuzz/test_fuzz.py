"""Every reader of files on damaged and odd ones: finite values, or one line. Anything else fails the test.

What is read must be finite: a NaN that a reader lets through is found much later, by somebody else. Good files are
damaged by splices of bytes that parsers trip over, by edits after which most of them can still be parsed, and by whole
documents of odd content with the checksum that belongs to it. The examples are the same in every run and bounded in
number; ``FUZZ_INPUTS`` lets them go on (``tests/fuzzing.py``).
"""

from __future__ import annotations

import io
import json
import struct
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import torch
import trimesh
from fuzzing import EDITS, JSON, SPLICES, Edit, Splice, altered, damaged, edited, fuzz, reads_or_says_one_line
from hypothesis import strategies as st
from numpy_bytes import npz, of_array
from radar_files import CFG
from raw_files import quantised, radar_file, scene, write_cascade, write_two_lanes

from datafactory.frame.points import read_targets
from datafactory.paths.storage import TracedFrame, paths_schema, read_paths, to_row, writer_options
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.run.order import Order, TracedFolder, stored_paths
from datafactory.run.shards import write_tables
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from shared.dataset import METADATA_KEY
from shared.dataset.documents import sealed
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import radar_of, read_description, read_frames
from shared.radar import Radar, load_radar

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainer"))
from small_evaluation import FULL, make_run
from tiny_radar import RADAR as TINY
from tiny_radar import small_dataset

from trainer.captures.calibration import read_calibration, to_toml
from trainer.captures.cube_file import Capture, read_cube, write_cube
from trainer.captures.importing import import_capture, read_capture
from trainer.captures.reading import read_npz
from trainer.captures.samples import Reading
from trainer.data.arrays import choose_array
from trainer.data.measurements import open_measurements
from trainer.evaluation.experiments.measured_input import read_snapshot
from trainer.run.folder import load_imager, read_run
from trainer.training.callbacks import RESTORED, require_checkpoint

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

CUBE = of_array(np.ones((TINY.waveform.chirps, TINY.waveform.samples, TINY.array.channels), np.complex64))
SHARD, PATHS = "data/train/part-00000.parquet", "paths/part-00000.parquet"
TIMES_S = (-1.0, 0.0, 0.3, 1.0, 50.0)
"""Times at which what moves is looked at: before, at, between, at and after its samples."""


def finite_radar(path: Path) -> None:
    json.dumps(load_radar(str(path)).metadata(), allow_nan=False)


def finite_poses(path: Path) -> None:
    for pose in read_poses(path):
        assert np.isfinite([*pose.position, *pose.velocity, *pose.quaternion(), pose.time_s]).all()


def finite_targets(path: Path) -> None:
    for frame in read_targets(path):
        placed = frame.echo_points(Radar(), 1)
        for values in (placed.position, placed.velocity, placed.rcs_dbsm, placed.phase_rad):
            assert np.isfinite(values).all()


def finite_materials(path: Path) -> None:
    json.dumps(load_materials(path).map_materials(["wall 1", "", "\x00"]).to_json(), allow_nan=False)


def finite_pattern(path: Path) -> None:
    radar = path.with_name("with-pattern.toml")
    radar.write_text(f'[front_end]\nrx_pattern = {{ kind = "table", file = "{path.name}" }}\n')
    finite_radar(radar)


def finite_scene(path: Path) -> None:
    scene = open_scene(str(path))
    assert np.isfinite(scene.bounds()).all()
    for item in scene.objects:
        assert np.isfinite(item.vertices).all()
        assert np.isfinite(item.velocity).all()
        assert 0 <= item.triangles.min() <= item.triangles.max() < len(item.vertices)
        for time in TIMES_S if item.moves else ():
            now = item.at(time)
            assert np.isfinite([now.vertices, now.velocities]).all()
    for target in scene.targets:
        for there in (target, *(target.at(time) for time in TIMES_S)):
            assert np.isfinite([*there.position, *there.velocity, *there.spin, there.rcs_dbsm]).all()


def finite_part(path: Path) -> None:
    """A scene that is a part of another."""
    outer = path.with_name("outer.xml")
    outer.write_text(f'<scene version="2.1.0"><include filename="{path.name}"/></scene>')
    finite_scene(outer)


def finite_shard(path: Path) -> None:
    frames = list(read_frames(path))
    radar = radar_of(read_description(path), path)
    assert frames[0].image.shape == (radar.waveform.range_bins, radar.grid.bins)


def everything(path: Path) -> None:
    """What the commands read of the dataset whose manifest this is."""
    dataset = open_dataset(path.parent)
    radar_of(dataset.description(), path.parent)
    for split in dataset.splits:
        list(dataset.frames(split))
        list(open_measurements(path.parent, None, split)[1])
    verify(dataset)


def finite_measurements(path: Path) -> None:
    """Of a cube; its radar stands beside it, or within."""
    beside = str(path.with_name("tiny.toml")) if path.suffix == ".npy" else None
    for measurement in open_measurements(path, beside, "test")[1]:
        assert np.isfinite(measurement.range_channel).all()


def finite_capture(path: Path, board: str = "iwr1642", chirps: str = "capture.toml") -> None:
    """With the axes of the cube's file, where it is one of arrays."""
    axes = "frame chirp sample (rx tx)" if path.suffix in (".npy", ".mat", ".h5") else None
    assert np.isfinite(read_capture(path, Reading(board, str(path.parent / chirps), axes)).cube).all()


def finite_cascade(path: Path) -> None:
    read_capture(path.parent, Reading("mmwcas", str(path.parent / "capture.toml")))


def applied(path: Path) -> None:
    """A calibration, on a capture."""
    reading = Reading("iwr1642", str(path.parent / "capture.toml"), frames=(0, 1))
    import_capture(path.parent / "good.bin", path.parent / "c.npz", reading, path, str)


BINARY_USD = {"binary.usdc": finite_scene, "binary.usdz": finite_scene}
"""A quarter of a second each, most of it in the operating system."""
TEXTS: dict[str, Callable[[Path], object]] = {
    "radar.toml": finite_radar,
    "materials.toml": finite_materials,
    "poses.json": finite_poses,
    "targets.json": finite_targets,
    "pattern.csv": finite_pattern,
    "scene.usda": finite_scene,
    "scene.xml": finite_scene,
    "inner.xml": finite_part,
    "scene.obj": finite_scene,
    "box.ply": finite_scene,
    "box.stl": finite_scene,
    "profile.cfg": lambda path: finite_capture(path.with_name("good.bin"), "iwr1843", path.name),
    "capture.toml": lambda path: finite_capture(path.with_name("good.bin")),
}
"""Readers of texts, by the file that is damaged; others read it where it lies."""
READERS: dict[str, Callable[[Path], object]] = {
    **TEXTS,
    **BINARY_USD,
    "array.toml": lambda path: choose_array(str(path), TINY),
    "calibration.toml": read_calibration,
    "run/run.json": lambda path: read_run(path.parent),
    "run/weights.safetensors": lambda path: load_imager(path.parent),
    "last.ckpt": require_checkpoint,
    "part.ply": finite_scene,
    "part.stl": finite_scene,
    "part.obj": finite_scene,
    "part.glb": finite_scene,
    SHARD: finite_shard,
    PATHS: lambda path: list(read_paths(path)),
    f"data/{MANIFEST}": lambda path: verify(open_dataset(path.parent)),
    **dict.fromkeys(("good.bin", "good.npy", "good.mat", "good.h5"), finite_capture),
    **{f"cascade/{name}.bin": finite_cascade for name in ("master_0000_data", "slave2_0000_data", "master_0000_idx")},
    "cube.npy": finite_measurements,
    "cube.npz": finite_measurements,
    "described.npz": lambda path: read_cube(path, None),
    "cell.npz": read_npz,
    "snapshot.npy": read_snapshot,
    "snapshot.mat": read_snapshot,
}


def saved(function: Callable[..., object], *arguments: object) -> bytes:
    """What a function writes into a file that it is given first."""
    buffer = io.BytesIO()
    function(buffer, *arguments)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole files, each in the place where it is damaged, and what they refer to."""
    from pxr import Usd, UsdUtils

    made = tmp_path_factory.mktemp("fuzz")
    made.joinpath("cascade").mkdir()
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    snapshot = np.exp(1j * np.arange(12.0))
    state = {**{name: {} for name in RESTORED}, "state_dict": {"weight": torch.arange(6.0).reshape(2, 3)}}
    cube_of_tiny = {"cube": CUBE, "radar": of_array(TINY.model_dump_json())}
    radar = load_radar(str(radar_file(made, "iwr1642")))
    captured = quantised(scene(radar, 2))
    contents = {
        "radar.toml": RADAR, "materials.toml": MATERIALS, "poses.json": POSES, "targets.json": TARGETS,
        "pattern.csv": PATTERN, "scene.usda": USD, "scene.xml": XML, "inner.xml": INNER, "scene.obj": OBJ,
        "box.ply": box.export(file_type="ply", encoding="ascii"), "box.stl": box.export(file_type="stl_ascii").encode(),
        "profile.cfg": CFG.replace("256 5209", "32 2000").replace("0 1 16", "0 1 4").encode(),
        "array.toml": b'rx = [0, 1, 2, 5]\nname = "thin"\n',
        "last.ckpt": saved(lambda file: torch.save(state, file)), "cube.npy": CUBE, "cube.npz": npz(**cube_of_tiny),
        "cell.npz": npz(levels=of_array(np.arange(20.0)), rows=of_array(3)), "snapshot.npy": of_array(snapshot),
        "snapshot.mat": saved(scipy.io.savemat, {"snapshot": snapshot[None]}), "good.npy": of_array(captured),
        "good.mat": saved(scipy.io.savemat, {"adc": captured, "time": np.arange(3, dtype=np.int16)}),
        "calibration.toml": to_toml(calibration(radar)).encode(),
    }  # fmt: skip
    for name, content in contents.items():
        (made / name).write_bytes(content)
    for suffix in ("ply", "stl", "obj", "glb"):
        box.export(made / f"part.{suffix}")
    Usd.Stage.Open(str(made / "scene.usda")).Export(str(made / "binary.usdc"))
    UsdUtils.CreateNewUsdzPackage(str(made / "binary.usdc"), str(made / "binary.usdz"))
    make_run(made / "run", FULL, TINY)
    small_dataset(made / "data", 1, 1)
    points = ScatteredPaths.of_points(np.ones((2, 3)), np.zeros((2, 3)), np.ones(2))
    traced = TracedFrame(0, "scene", 0, 1, Pose((0.0, 0.0, 0.0)), 0.0039, 0, PathTable(points, objects=("a",)))
    rows = [pa.Table.from_pylist([to_row(traced)], schema=paths_schema())]
    write_tables(made / PATHS, rows, paths_schema(), **writer_options())
    write_two_lanes(made / "good.bin", scene(radar, 2), radar)
    with h5py.File(made / "good.h5", "w") as file:
        file.create_dataset("adc", data=captured, chunks=True, compression="gzip")
    four = load_radar(str(radar_file(made / "cascade", "mmwcas", "tx = [12]")))
    write_cascade(made / "cascade", scene(four), four)
    about = Capture(source="a", source_sha256="0" * 64, board="iwr1642", frames=1, scale="relative", noise_power=1.0)
    write_cube(made / "described.npz", quantised(scene(radar)), radar, about)
    (made / "tiny.toml").write_text(
        f"[waveform]\nchirps = {TINY.waveform.chirps}\nsamples = {TINY.waveform.samples}\nrange_bins = 24\n[array]\n"
        f"tx_m = {json.dumps(TINY.array.tx_m)}\nrx_m = {json.dumps(TINY.array.rx_m)}\n"
    )
    return made


def calibration(radar: Radar) -> dict[str, Any]:
    channels, waveform = radar.array.channels, radar.waveform
    document = {
        "board": "iwr1642", "array": radar.array.model_dump(), "carrier_hz": waveform.carrier_hz,
        "bandwidth_hz": waveform.bandwidth_hz, "gain_db": [0.5] * channels, "phase_deg": [3.0] * channels,
        "delay_s": [1e-12] * channels, "dead_channels": [2], "model_error_db": -20.5,
        "captures": [{"source": "a.bin", "source_sha256": "0" * 64, "range_m": 3.0, "angle_deg": 1.0}],
    }  # fmt: skip
    return sealed(document)


def tried(path: Path, contents: Iterable[bytes], read: Callable[[Path], object]) -> None:
    """Each in the place of the whole file, which is there again in the end."""
    whole = path.read_bytes()
    try:
        for content in contents:
            path.write_bytes(content)
            reads_or_says_one_line(lambda: read(path))
    finally:
        path.write_bytes(whole)


@pytest.mark.parametrize("name", READERS)
def test_the_whole_file_is_read(folder: Path, name: str) -> None:
    READERS[name](folder / name)


@pytest.mark.parametrize("name", [name for name in READERS if name not in BINARY_USD])
@fuzz(100, splices=SPLICES, keep=st.floats(0.0, 1.0))
def test_damaged(folder: Path, name: str, splices: list[Splice], keep: float) -> None:
    """In some places, and cut off."""
    whole = (folder / name).read_bytes()
    tried(folder / name, (damaged(whole, splices), whole[: int(keep * len(whole))]), READERS[name])


@pytest.mark.parametrize("name", BINARY_USD)
@fuzz(12, splices=SPLICES)
def test_damaged_binary_usd(folder: Path, name: str, splices: list[Splice]) -> None:
    tried(folder / name, [damaged((folder / name).read_bytes(), splices)], finite_scene)


@pytest.mark.parametrize("name", TEXTS)
@fuzz(120, edits=EDITS)
def test_edited_text(folder: Path, name: str, edits: list[Edit]) -> None:
    tried(folder / name, [edited((folder / name).read_bytes(), edits)], READERS[name])


@fuzz(100, splices=SPLICES, edits=EDITS)
def test_a_header_of_numpys_that_was_edited(folder: Path, splices: list[Splice], edits: list[Edit]) -> None:
    text = damaged(edited(b"\n" + CUBE[10:128], edits)[1:], splices[:1])
    odd = CUBE[:8] + struct.pack("<H", len(text)) + text + CUBE[128:]
    tried(folder / "cube.npy", [odd], finite_measurements)


Alter = Callable[[Any], Any]


def as_sealed(document: Any) -> Any:
    """With the checksum that belongs to it; with NaN or infinity, which no file of ours has, as it is."""
    try:
        return sealed(document)
    except ValueError:
        return document


def odd_json(whole: bytes, alter: Alter) -> bytes:
    return json.dumps(alter(json.loads(whole))).encode()


def odd_run(whole: bytes, alter: Alter) -> bytes:
    return json.dumps(as_sealed(alter(json.loads(whole)))).encode()


def odd_manifest(whole: bytes, alter: Alter) -> bytes:
    """With a plan of what was traced beside the frames."""
    more = {
        "arguments": {"radar": {"front_end": {"tx_polarization": "V"}}, "split": "6:1:1", "poses": []},
        "scenes": [{"name": "hall", "effect_plan": {"effects": [{"effect": "specular", "on": True}]}}],
        "counts": {"rays": 3},
    }
    return json.dumps(as_sealed(alter(json.loads(whole) | more))).encode()


def odd_plan(whole: bytes, alter: Alter) -> bytes:
    document = json.loads(odd_manifest(whole, alter))
    document["shards"] = [{"path": PATHS, "rows": 1, "bytes": 1, "sha256": "0" * 64}]
    return json.dumps(document).encode()


def odd_weights(whole: bytes, alter: Alter) -> bytes:
    size = int.from_bytes(whole[:8], "little")
    text = odd_json(whole[8 : 8 + size], alter)
    return len(text).to_bytes(8, "little") + text + whole[8 + size :]


def odd_gltf(whole: bytes, alter: Alter) -> bytes:
    size = int.from_bytes(whole[12:16], "little")
    header = json.loads(whole[20 : 20 + size]) | {"animations": [{}], "skins": []}
    text = json.dumps(alter(header)).encode()
    text += b" " * (-len(text) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + whole[20 + size :]
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


def odd_shard(whole: bytes, alter: Alter) -> bytes:
    table = pq.read_table(pa.BufferReader(whole))
    about = odd_json(table.schema.metadata[METADATA_KEY], alter)
    return saved(lambda file: pq.write_table(table.replace_schema_metadata({METADATA_KEY: about}), file))


def odd_radar(whole: bytes, alter: Alter) -> bytes:
    return npz(cube=CUBE, radar=of_array(odd_json(TINY.model_dump_json().encode(), alter).decode()))


def odd_description(whole: bytes, alter: Alter) -> bytes:
    with np.load(io.BytesIO(whole)) as stored:
        content = dict(stored)
    capture = odd_json(str(content["capture"]).encode(), alter).decode()
    return saved(lambda file: np.savez(file, **(content | {"capture": np.asarray(capture)})))


def odd_calibration(whole: bytes, alter: Alter) -> bytes:
    document = calibration(load_radar("iwr1642"))
    try:
        text = to_toml(sealed(alter({name: value for name, value in document.items() if name != "sha256"})))
    except (ValueError, AttributeError):  # NaN, or no table at all
        return whole
    return text.encode("utf-8", errors="surrogateescape")


def plan_of(path: Path) -> None:
    stored_paths(Order(radar=Radar()), TracedFolder.opened(path.parent))


DOCUMENTS: dict[str, tuple[str, Callable[[bytes, Alter], bytes], Callable[[Path], object]]] = {
    "poses": ("poses.json", odd_json, finite_poses),
    "targets": ("targets.json", odd_json, finite_targets),
    "run": ("run/run.json", odd_run, READERS["run/run.json"]),
    "weights": ("run/weights.safetensors", odd_weights, READERS["run/weights.safetensors"]),
    "glTF": ("part.glb", odd_gltf, finite_scene),
    "shard": (SHARD, odd_shard, finite_shard),
    "manifest": (f"data/{MANIFEST}", odd_manifest, everything),
    "plan of traced paths": (f"data/{MANIFEST}", odd_plan, plan_of),
    "radar in a cube": ("cube.npz", odd_radar, finite_measurements),
    "capture in a cube": ("described.npz", odd_description, READERS["described.npz"]),
    "calibration": ("calibration.toml", odd_calibration, applied),
}
"""File, how it is written with odd content, and who reads it: of the right syntax, as anyone can write it."""


@pytest.mark.parametrize("name", DOCUMENTS)
@fuzz(120, edits=st.lists(st.tuples(st.floats(0.0, 1.0), JSON | st.integers(-2, 9)), min_size=1, max_size=4))
def test_odd_content(folder: Path, name: str, edits: list[tuple[float, Any]]) -> None:
    file, write, read = DOCUMENTS[name]
    content = write((folder / file).read_bytes(), lambda document: altered(document, edits))
    tried(folder / file, [content], read)


COLUMN_TYPES = (pa.int64(), pa.float32(), pa.string(), pa.binary(), pa.list_(pa.float32()), pa.list_(pa.float64(), 3))


@fuzz(100, column=st.integers(0, 30), kind=st.sampled_from(COLUMN_TYPES), nothing=st.booleans())
def test_a_shard_of_odd_columns(folder: Path, column: int, kind: pa.DataType, nothing: bool) -> None:
    table = pq.read_table(folder / SHARD)
    place = column % len(table.column_names)
    name, old = table.column_names[place], table.schema.field(place).type
    odd = table.set_column(place, name, pa.nulls(len(table), old if nothing else kind))
    tried(folder / SHARD, [saved(lambda file: pq.write_table(odd, file))], lambda path: list(read_frames(path)))


@fuzz(100, text=st.text("() framechiptxsqlo\n", max_size=40))
def test_odd_axes(folder: Path, text: str) -> None:
    reading = Reading("iwr1642", str(folder / "capture.toml"), text)
    reads_or_says_one_line(lambda: read_capture(folder / "good.npy", reading))
