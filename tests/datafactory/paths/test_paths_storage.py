"""Path tables survive the disk bit for bit."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from datafactory.paths.storage import TracedFrame, paths_schema, read_paths, to_row
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
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
    between = {"between_m": real(scattered), "between_rate_mps": real(scattered)}
    image = {"image": real(specular, 3), "image_velocity": real(specular, 3), "axes": real(specular, 3, 3)}
    table = PathTable(
        ScatteredPaths(**vectors, **between, **whole(scattered)),
        SpecularPaths(reference=real(3), **image, **whole(specular)),
        objects=("wall", "Größe"),
        counts={"rays": 5, "pruned": 0},
    )
    pose = Pose((1.0, 2.0, 3.0), 10.0, -2.0, 0.5, (4.0, 5.0, 6.0), 0.25)
    things = tuple(
        SeenThing(f"car {n}", "car", *map(tuple, real(6, 3).tolist()), tuple(range(n)))  # type: ignore[arg-type]
        for n in range(frame_id)
    )
    return TracedFrame(frame_id, "scene", 1, 2**62, pose, 3.87e-3, 1, table, things)


def test_round_trip(tmp_path):
    frames = [a_frame(0, 7, 2), a_frame(1, 0, 0), a_frame(2, 1, 1)]
    path = tmp_path / "part-00000.parquet"
    with pq.ParquetWriter(path, paths_schema()) as writer:
        for frame in frames:
            writer.write_table(pa.Table.from_pylist([to_row(frame)], schema=paths_schema()))
    for read, written in zip(read_paths(path), frames, strict=True):
        for name in ("frame_id", "scene", "seed", "pose", "wavelength_m", "point_targets", "things"):
            assert getattr(read, name) == getattr(written, name)
        assert read.table.objects == written.table.objects
        assert read.table.counts == written.table.counts
        for kind in ("scattered", "specular"):
            ours, theirs = vars(getattr(read.table, kind)), vars(getattr(written.table, kind))
            for name, value in theirs.items():
                assert ours[name].dtype == value.dtype
                np.testing.assert_array_equal(ours[name], value)


@pytest.mark.parametrize("foreign", [b"", b"PAR1 but not Parquet", None])
def test_a_foreign_file_is_named(tmp_path, foreign):
    path = tmp_path / "part-00000.parquet"
    if foreign is None:
        pq.write_table(pa.table({"a": [1]}), path)
    else:
        path.write_bytes(foreign)
    with pytest.raises(InputError, match="part-00000"):
        list(read_paths(path))
