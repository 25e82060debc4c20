"""Every reader of files on damaged and odd ones: finite values, or one line. Anything else fails the test.

What is read must be finite: a NaN that a reader lets through is found much later, by somebody else. Good files are
damaged by splices of bytes that parsers trip over, and by whole documents of odd content with the checksum that belongs
to it. The examples are the same in every run and bounded in number; ``FUZZ_INPUTS`` lets them go on
(``tests/fuzzing.py``).
"""

import io
import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fuzz_files import CUBE, PATHS, SHARD, TINY, calibration, saved, write_whole_files
from fuzzing import JSON, SPLICES, Splice, altered, damaged, fuzz, reads_or_says_one_line
from hypothesis import strategies as st
from numpy_bytes import npz, of_array

from datafactory.frame.points import read_targets
from datafactory.paths.storage import read_paths
from datafactory.run.preparation import stored_paths
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.scenes.readers.open import open_scene
from shared.dataset import METADATA_KEY
from shared.dataset.documents import sealed
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import radar_of, read_description, read_frames
from shared.radar import Radar, load_radar
from trainer.captures import reading
from trainer.captures.calibration import read_calibration, to_toml
from trainer.captures.cube_file import read_cube
from trainer.captures.importing import import_capture, read_capture
from trainer.captures.options import Reading
from trainer.captures.reading import read_npz
from trainer.data.arrays import choose_array
from trainer.data.measurements import open_measurements
from trainer.evaluation.experiments.measured_input import read_snapshot
from trainer.run.folder import load_imager, read_run
from trainer.training.callbacks import require_checkpoint

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
        assert np.isfinite(measurement.cells.range_channel).all()


def finite_capture(path: Path, board: str = "iwr1642", chirps: str = "capture.toml") -> None:
    """With the axes of the cube's file, where it is one of arrays."""
    axes = "frame chirp sample (rx tx)" if path.suffix in (".npy", ".mat", ".h5") else None
    assert np.isfinite(read_capture(path, Reading(board, radar=str(path.parent / chirps), axes=axes)).cube).all()


def finite_cascade(path: Path) -> None:
    read_capture(path.parent, Reading("mmwcas", radar=str(path.parent / "capture.toml")))


def applied(path: Path) -> None:
    """A calibration, on a capture."""
    beside = path.parent
    (beside / "c.npz").unlink(missing_ok=True)
    import_capture("iwr1642", radar=str(beside / "capture.toml"), frames=(0, 1), capture=beside / "good.bin",
                   out=beside / "c.npz", calibration=path)  # fmt: skip


BINARY_USD = {"binary.usdc": finite_scene, "binary.usdz": finite_scene}
"""A quarter of a second each, most of it in the operating system."""
READERS: dict[str, Callable[[Path], object]] = {
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("fuzz")
    write_whole_files(made)
    return made


FORKING = """
import json, os, sys, traceback
import h5py, numpy, scipy.io
from reading_process import main

for line in sys.stdin:
    *arguments, said = json.loads(line)
    child = os.fork()
    if not child:
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        status = 1
        try:
            status = main(*arguments)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(scope="module", autouse=True)
def forked_reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Files of arrays are read by forks of one process: thousands of damaged ones, where each starts Python anew
    otherwise. Every file still has a process of its own, with the bounds and the exit status of the command's."""
    said = tmp_path_factory.mktemp("reader") / "said"
    command = [sys.executable, "-c", FORKING]
    with (
        subprocess.Popen(
            command, cwd=Path(reading.READER).parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as process,
        pytest.MonkeyPatch.context() as patch,
    ):
        asked, ended = process.stdin, process.stdout
        assert asked is not None
        assert ended is not None

        def run_reader(*arguments: str) -> tuple[int, bytes]:
            asked.write(json.dumps([*arguments, str(said)]) + "\n")
            asked.flush()
            return int(ended.readline()), said.read_bytes()

        patch.setattr(reading, "run_reader", run_reader)
        yield
        asked.close()


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
    stored_paths(path.parent, Radar(), None, None)


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
