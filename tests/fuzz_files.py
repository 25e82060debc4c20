"""Good files of every kind that is read, which the fuzzers damage."""

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
import torch
import trimesh
from numpy_bytes import npz, of_array
from raw_files import CFG, quantised, radar_file, scene, write_cascade, write_two_lanes

from datafactory.paths.storage import TracedFrame, paths_schema, to_row, writer_options
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.run.shards import write_tables
from datafactory.scenes.poses import Pose
from shared.dataset.documents import sealed
from shared.radar import Radar, load_radar

sys.path.append(str(Path(__file__).resolve().parent / "trainer"))
from small_evaluation import FULL, make_run
from tiny_radar import RADAR as TINY
from tiny_radar import small_dataset

from trainer.captures.calibration import to_toml
from trainer.captures.cube_file import Capture, write_cube
from trainer.training.callbacks import RESTORED

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
pattern = "lambertian"
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


def saved(function: Callable[..., object], *arguments: object) -> bytes:
    """What a function writes into a file that it is given first."""
    buffer = io.BytesIO()
    function(buffer, *arguments)
    return buffer.getvalue()


def write_whole_files(made: Path) -> None:
    """Each in the place where it is damaged, and what they refer to."""
    from pxr import Usd, UsdUtils

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


def calibration(radar: Radar) -> dict[str, Any]:
    """Of a board, with its checksum."""
    channels, waveform = radar.array.channels, radar.waveform
    document = {
        "board": "iwr1642", "array": radar.array.model_dump(), "carrier_hz": waveform.carrier_hz,
        "bandwidth_hz": waveform.bandwidth_hz, "gain_db": [0.5] * channels, "phase_deg": [3.0] * channels,
        "delay_s": [1e-12] * channels, "dead_channels": [2], "model_error_db": -20.5,
        "captures": [{"source": "a.bin", "source_sha256": "0" * 64, "range_m": 3.0, "angle_deg": 1.0}],
    }  # fmt: skip
    return sealed(document)
