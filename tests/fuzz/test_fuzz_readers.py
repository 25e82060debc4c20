"""The readers of datasets on damaged files: they read, or say one line. Anything else fails the test.

Good files are damaged by splices of bytes that parsers trip over. The examples are the same in every run and bounded
in number; ``FUZZ_SECONDS`` lets them go on (``tests/fuzzing.py``).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from fuzzing import SPLICES, Splice, damaged, fuzz, reads_or_says_one_line

from datafactory.paths.storage import TracedFrame, paths_schema, read_paths, to_row, writer_options
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.run.shards import write_shard, write_tables
from datafactory.scenes.poses import Pose
from shared.dataset import VERSION, Frame, arrow_schema, description
from shared.dataset.folder import MANIFEST, open_dataset, verify
from shared.dataset.reading import read_frames
from shared.radar import ImageGrid, Radar
from shared.radar.waveform import Waveform


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
