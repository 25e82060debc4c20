"""Path tables survive the disk bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from datafactory.paths.storage import (
    TWO_POINTS,
    TracedFrame,
    paths_schema,
    read_frame_paths,
    read_paths,
    to_row,
    writer_options,
)
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.run.shards import write_tables
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.poses import Pose
from shared.physics.errors import InputError


def a_frame(frame_id: int, scattered: int, specular: int) -> TracedFrame:
    generator = np.random.default_rng(frame_id)

    def real(*shape: int) -> np.ndarray:
        return generator.normal(size=shape)

    def whole(count: int) -> dict:
        return {
            "amplitude": real(count) + 1j * real(count),
            "depth": generator.integers(1, 4, count).astype(np.int8),
            "object_index": generator.integers(-1, 9, count).astype(np.int32),
            "kinds": generator.integers(1, 32, count).astype(np.uint8),
        }

    names = ("tx_point", "rx_point", "tx_velocity", "rx_velocity")
    vectors = {name: real(scattered, 3) for name in names}
    vectors["tx_point"][::2] = vectors["rx_point"][::2]  # of one point, as most are
    if scattered > 1:
        vectors["rx_point"][0, 0], vectors["tx_point"][0, 0] = 0.0, -0.0  # which differ in a bit
    between = {"between_m": real(scattered), "between_rate_mps": real(scattered)}
    image = {"image": real(specular, 3), "image_velocity": real(specular, 3), "axes": real(specular, 3, 3)}
    table = PathTable(
        ScatteredPaths(**vectors, **between, **whole(scattered)),
        SpecularPaths(**image, **whole(specular)),
        objects=("wall", "Größe"),
        counts={"rays": 5, "pruned": 0},
    )
    pose = Pose((1.0, 2.0, 3.0), 10.0, -2.0, 0.5, (4.0, 5.0, 6.0), 0.25)

    def triple() -> tuple[float, float, float]:
        x, y, z = real(3).tolist()
        return x, y, z

    things = tuple(
        SeenThing(f"car {n}", "car", triple(), triple(), triple(), triple(), triple(), triple(), tuple(range(n)))
        for n in range(frame_id)
    )
    return TracedFrame(frame_id, "scene", 1, 2**62, pose, 3.87e-3, 1, table, things)


def written(folder: Path, frames: list[TracedFrame]) -> Path:
    path = folder / "paths" / "part-00000.parquet"
    rows = (pa.Table.from_pylist([to_row(frame)], schema=paths_schema()) for frame in frames)
    write_tables(path, rows, paths_schema(), **writer_options())
    return path


def test_a_path_of_one_point_stores_it_once(tmp_path):
    frame = a_frame(0, 4000, 1)
    scattered = frame.table.scattered
    once = replace(frame, table=replace(frame.table, scattered=replace(scattered, tx_point=scattered.rx_point)))
    sizes = [written(tmp_path / name, [given]).stat().st_size for name, given in
             (("all", frame), ("once", once))]  # fmt: skip
    assert sizes[0] - sizes[1] > 0.9 * 24 * 2000  # half of the first frame's have two


@pytest.mark.parametrize("marks", [[True] * 7, [False] * 6, []])
def test_marks_that_do_not_belong_to_the_points_are_named(tmp_path, marks):
    path = tmp_path / "part-00000.parquet"
    row = {**to_row(a_frame(0, 7, 2)), TWO_POINTS: np.array(marks, dtype=bool)}
    pq.write_table(pa.Table.from_pylist([row], schema=paths_schema()), path)
    with pytest.raises(InputError, match=r"part-00000\.parquet: a row is not understood: 4 first points and"):
        list(read_paths(path))


def test_round_trip(tmp_path):
    frames = [a_frame(0, 7, 2), a_frame(1, 0, 0), a_frame(2, 1, 1)]
    path = written(tmp_path, frames)
    alone = [read_frame_paths(path, row) for row in range(3)]
    for read, given in zip([*read_paths(path), *alone], frames * 2, strict=True):
        for name in ("frame_id", "scene", "seed", "pose", "wavelength_m", "point_targets", "things"):
            assert getattr(read, name) == getattr(given, name)
        assert read.table.objects == given.table.objects
        assert read.table.counts == given.table.counts
        for kind in ("scattered", "specular"):
            ours, theirs = vars(getattr(read.table, kind)), vars(getattr(given.table, kind))
            for name, value in theirs.items():
                assert ours[name].dtype == value.dtype
                assert ours[name].tobytes() == value.tobytes()


def test_a_row_that_is_not_there_is_named(tmp_path):
    path = written(tmp_path, [a_frame(0, 7, 2)])
    with pytest.raises(InputError, match="1 rows, row 1 was asked for"):
        read_frame_paths(path, 1)


@pytest.mark.parametrize("foreign", [b"", b"PAR1 but not Parquet", None])
def test_a_foreign_file_is_named(tmp_path, foreign):
    path = tmp_path / "part-00000.parquet"
    if foreign is None:
        pq.write_table(pa.table({"a": [1]}), path)
    else:
        path.write_bytes(foreign)
    with pytest.raises(InputError, match="part-00000"):
        list(read_paths(path))
