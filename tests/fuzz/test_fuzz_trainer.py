"""The trainer's readers on damaged files and on whole files of odd content: they read, or say one line.

See ``tests/fuzzing.py``: ``FUZZ_INPUTS`` lets them go on.
"""

from __future__ import annotations

import io
import json
import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import torch
from fuzzing import EDITS, JSON, SPLICES, Edit, Splice, altered, damaged, edited, fuzz, reads_or_says_one_line
from hypothesis import strategies as st
from numpy_bytes import npz, of_array

from datafactory.run.order import Order, TracedFolder, stored_paths
from shared.dataset import METADATA_KEY
from shared.dataset.documents import sealed
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import radar_of, read_frames
from shared.radar import Radar

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainer"))
from small_evaluation import FULL, make_run
from tiny_radar import RADAR, small_dataset

from trainer.captures.reading import read_npz
from trainer.data.arrays import choose_array
from trainer.data.measurements import open_measurements
from trainer.evaluation.experiments.measured_input import read_snapshot
from trainer.run.folder import load_imager, read_run
from trainer.training.callbacks import RESTORED, require_checkpoint

ALTERATIONS = st.lists(st.tuples(st.floats(0.0, 1.0), JSON), min_size=1, max_size=3)
"""(which value, as a share of all; what stands there instead)."""
SHAPE = (RADAR.waveform.chirps, RADAR.waveform.samples, RADAR.array.channels)


CUBE = of_array(np.ones(SHAPE, np.complex64))
RADAR_JSON = RADAR.model_dump(mode="json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run and a dataset of two frames, and the radar of a cube beside them."""
    made = tmp_path_factory.mktemp("fuzz")
    make_run(made / "run", FULL, RADAR)
    small_dataset(made / "data", 1, 1)
    (made / "radar.toml").write_text(
        f"[waveform]\nchirps = {SHAPE[0]}\nsamples = {SHAPE[1]}\nrange_bins = 24\n[array]\n"
        f"tx_m = {json.dumps(RADAR.array.tx_m)}\nrx_m = {json.dumps(RADAR.array.rx_m)}\n"
    )
    return made


def measure(path: Path) -> None:
    """The cube's frame, which is finite."""
    beside = str(path.parent / "radar.toml") if path.suffix == ".npy" else None
    for measurement in open_measurements(path, beside, "test")[1]:
        assert np.isfinite(measurement.range_channel).all()


def write_and_read(path: Path, content: bytes, read: Callable[[Path], object]) -> None:
    path.write_bytes(content)
    reads_or_says_one_line(lambda: read(path))


def test_the_undamaged_files_are_read(folder: Path) -> None:
    (folder / "whole.npy").write_bytes(CUBE)
    (folder / "whole.npz").write_bytes(npz(cube=CUBE, radar=of_array(json.dumps(RADAR_JSON))))
    measure(folder / "whole.npy")
    measure(folder / "whole.npz")
    load_imager(folder / "run")


@fuzz(150, splices=SPLICES, edits=EDITS)
def test_damaged_cubes(folder: Path, splices: list[Splice], edits: list[Edit]) -> None:
    text = damaged(edited(b"\n" + CUBE[10:128], edits)[1:], splices[:1])
    odd_header = CUBE[:8] + struct.pack("<H", len(text)) + text + CUBE[128:]
    whole = npz(cube=CUBE, radar=of_array(json.dumps(RADAR_JSON)))
    write_and_read(folder / "damaged.npy", damaged(CUBE, splices), measure)
    write_and_read(folder / "damaged.npy", odd_header, measure)
    write_and_read(folder / "damaged.npz", damaged(whole, splices), measure)


@fuzz(150, alterations=ALTERATIONS)
def test_a_npz_of_an_odd_radar(folder: Path, alterations: list[tuple[float, Any]]) -> None:
    text = json.dumps(altered(RADAR_JSON, alterations))
    write_and_read(folder / "odd.npz", npz(cube=CUBE, radar=of_array(text)), measure)


@fuzz(100, splices=SPLICES)
def test_damaged_cell(folder: Path, splices: list[Splice]) -> None:
    whole = npz(levels=of_array(np.arange(20.0)), rows=of_array(3))
    write_and_read(folder / "cell.npz", damaged(whole, splices), read_npz)


@fuzz(100, splices=SPLICES)
def test_damaged_snapshot(folder: Path, splices: list[Splice]) -> None:
    snapshot = np.exp(1j * np.arange(12.0))
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"snapshot": snapshot[None]})
    for name, whole in (("snapshot.npy", of_array(snapshot)), ("snapshot.mat", buffer.getvalue())):
        write_and_read(folder / name, damaged(whole, splices), read_snapshot)


@fuzz(120, splices=SPLICES)
def test_damaged_array_file(folder: Path, splices: list[Splice]) -> None:
    text = b'rx = [0, 1, 2, 5]\nname = "thin"\n'
    write_and_read(folder / "array.toml", damaged(text, splices), lambda path: choose_array(str(path), RADAR))


@fuzz(120, splices=SPLICES, alterations=ALTERATIONS)
def test_damaged_run(folder: Path, splices: list[Splice], alterations: list[tuple[float, Any]]) -> None:
    path = folder / "other" / "run.json"
    path.parent.mkdir(exist_ok=True)
    whole = (folder / "run" / "run.json").read_bytes()
    odd = _as_sealed(altered(json.loads(whole), alterations))
    for content in (damaged(whole, splices), json.dumps(odd).encode()):
        write_and_read(path, content, lambda path: read_run(path.parent))


@fuzz(100, splices=SPLICES, alterations=ALTERATIONS)
def test_damaged_weights(folder: Path, splices: list[Splice], alterations: list[tuple[float, Any]]) -> None:
    whole = (folder / "run" / "weights.safetensors").read_bytes()
    size = int.from_bytes(whole[:8], "little")
    text = json.dumps(altered(json.loads(whole[8 : 8 + size]), alterations)).encode()
    other = folder / "weights"
    other.mkdir(exist_ok=True)
    (other / "run.json").write_bytes((folder / "run" / "run.json").read_bytes())
    for content in (damaged(whole, splices), len(text).to_bytes(8, "little") + text + whole[8 + size :]):
        (other / "weights.safetensors").write_bytes(content)
        reads_or_says_one_line(lambda: load_imager(other))


@fuzz(120, splices=SPLICES)
def test_damaged_checkpoint(folder: Path, splices: list[Splice]) -> None:
    buffer = io.BytesIO()
    torch.save({**{name: {} for name in RESTORED}, "state_dict": {"weight": torch.arange(6.0).reshape(2, 3)}}, buffer)
    write_and_read(folder / "last.ckpt", damaged(buffer.getvalue(), splices), require_checkpoint)


def everything(directory: Path) -> None:
    """What the commands read of a dataset."""
    dataset = open_dataset(directory)
    radar_of(dataset.description(), directory)
    for split in dataset.splits:
        list(dataset.frames(split))
        list(open_measurements(directory, None, split)[1])
    verify(dataset)


@fuzz(100, alterations=ALTERATIONS)
def test_a_shard_of_an_odd_description(folder: Path, alterations: list[tuple[float, Any]]) -> None:
    """A whole file, as anyone can write it."""
    table = pq.read_table(folder / "data/train/part-00000.parquet")
    about = altered(json.loads(table.schema.metadata[METADATA_KEY]), alterations)
    odd = table.replace_schema_metadata({METADATA_KEY: json.dumps(about).encode()})
    path = folder / "odd" / "train" / "part-00000.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(odd, path)

    def read(path: Path) -> None:
        frames = list(read_frames(path))
        radar = radar_of(about, path)
        assert frames[0].image.shape == (radar.waveform.range_bins, radar.grid.bins)

    reads_or_says_one_line(lambda: read(path))


COLUMN_TYPES = (pa.int64(), pa.float32(), pa.string(), pa.binary(), pa.list_(pa.float32()), pa.list_(pa.float64(), 3))


@fuzz(100, column=st.integers(0, 30), kind=st.sampled_from(COLUMN_TYPES), nothing=st.booleans())
def test_a_shard_of_odd_columns(folder: Path, column: int, kind: pa.DataType, nothing: bool) -> None:
    table = pq.read_table(folder / "data/train/part-00000.parquet")
    place = column % len(table.column_names)
    name, old = table.column_names[place], table.schema.field(place).type
    values = pa.nulls(len(table), old if nothing else kind)
    odd = table.set_column(place, name, values)
    path = folder / "odd.parquet"
    pq.write_table(odd, path)
    reads_or_says_one_line(lambda: list(read_frames(path)))


@fuzz(120, alterations=ALTERATIONS)
def test_a_manifest_of_odd_content(folder: Path, alterations: list[tuple[float, Any]]) -> None:
    """With the checksum that belongs to it, and a plan of what was traced beside the frames."""
    whole = json.loads((folder / "data" / MANIFEST).read_bytes()) | {
        "arguments": {"radar": {"front_end": {"tx_polarization": "V"}}, "split": "6:1:1", "poses": []},
        "scenes": [{"name": "hall", "effect_plan": {"effects": [{"effect": "specular", "on": True}]}}],
        "counts": {"rays": 3},
    }
    other = folder / "manifest"
    other.mkdir(exist_ok=True)
    for split in ("train", "validation"):
        if not (other / split).exists():
            os.symlink(folder / "data" / split, other / split)
    document = altered(whole, alterations)
    (other / MANIFEST).write_text(json.dumps(_as_sealed(document)), encoding="utf-8")
    reads_or_says_one_line(lambda: everything(other))
    document["shards"] = [{"path": "paths/part-00000.parquet", "rows": 1, "bytes": 1, "sha256": "0" * 64}]
    (other / MANIFEST).write_text(json.dumps(document), encoding="utf-8")
    reads_or_says_one_line(lambda: stored_paths(Order(radar=Radar()), TracedFolder.opened(other)))


def _as_sealed(document: Any) -> Any:
    """With the checksum that belongs to it; with NaN or infinity, which no file of ours has, as it is."""
    try:
        return sealed(document)
    except ValueError:
        return document
