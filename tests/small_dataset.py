"""Datasets of a few frames, made in no time: a tiny radar, random frames of it, shards, folders with a manifest."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from shared.dataset import Box, Frame, Target, arrow_schema, description, to_record_batch
from shared.dataset.folder import Dataset
from shared.dataset.locations import sha256_of
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform

ROWS, BINS, CHIRPS, SAMPLES, PEAKS, RX = 6, 20, 4, 8, 3, 4
RADAR = Radar(
    waveform=Waveform(chirps=CHIRPS, samples=SAMPLES, range_bins=ROWS),
    array=AntennaArray(tx_m=line(np.array([0.0, 2e-3])), rx_m=line(4e-3 * np.arange(RX))),
    grid=ImageGrid(u_start=-0.5, u_stop=0.5, bins=BINS),
    virtual_sensor=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(8))),
)
CHANNELS = RADAR.array.channels
ONE_SHARD = {"train/part-00000": (0, 1, 2)}


def make_frame(frame_id: int, store: str = "range-channel") -> Frame:
    """A random frame, the same for the same number; every column differs from frame to frame."""
    generator = np.random.default_rng(frame_id)

    def real(*shape: int) -> np.ndarray:
        return generator.standard_normal(shape).astype(np.float32)

    def signal(*shape: int) -> np.ndarray:
        return (real(*shape) + 1j * real(*shape)).astype(np.complex64)

    return Frame(
        frame_id=frame_id,
        kind="scene" if frame_id % 2 else "points",
        scene="street é",
        seed=2**62 + frame_id,
        sensor_position=(1.0, -2.0, 0.1),
        sensor_velocity=(10.0, 0.0, 1 / 3),
        sensor_orientation=(1.0, 0.0, 0.0, 0.0),
        range_channel=signal(PEAKS, ROWS, CHANNELS),
        velocity=real(PEAKS, ROWS),
        image=np.abs(real(ROWS, BINS)),
        image_peak=1e-7 / (3 + frame_id),
        noise_power=1e-16 / 3,
        targets=tuple(Target(float(k), 0.1 * k, -1.0 / 3, -90.0 - k, "car" * (k % 2)) for k in range(frame_id % 4)),
        boxes=tuple(
            Box((9.0, k / 3, 0.1), (4.5, 1.8, 1.5), -k / 3, (-1.0, 0.0, k / 7), "car", f"Größe {k}", 1e-15 * k)
            for k in range(frame_id % 3)
        ),
        range_doppler=np.abs(real(ROWS, CHIRPS)) if store == "range-doppler" else None,
        cube=signal(CHIRPS, SAMPLES, CHANNELS) if store == "cube" else None,
    )


def write(
    path: Path,
    frames: Sequence[Frame],
    store: str = "range-channel",
    rows_per_group: int = 1,
    radar: Radar = RADAR,
    **extra: object,
) -> None:
    """A shard of these frames; ``extra`` goes into its description."""
    schema = arrow_schema(description(radar, PEAKS, store, extra))
    path.parent.mkdir(exist_ok=True, parents=True)
    table = pa.Table.from_batches([to_record_batch(frames, schema)])
    pq.write_table(table, path, row_group_size=rows_per_group)


def assert_same(left: Frame, right: Frame) -> None:
    """Every column, bit for bit."""
    for field in dataclasses.fields(Frame):
        one, other = getattr(left, field.name), getattr(right, field.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype, field.name
            assert one.shape == other.shape, field.name
            assert one.tobytes() == other.tobytes(), field.name
        else:
            assert one == other, field.name


def write_manifest(folder: Path, rows: Mapping[str, int]) -> None:
    """The manifest of shards that are there: numbers of rows by path."""
    shards = [
        {"path": path, "rows": count, "bytes": (folder / path).stat().st_size, "sha256": sha256_of(folder / path)}
        for path, count in rows.items()
    ]
    (folder / "manifest.json").write_text(json.dumps({"version": 1, "shards": shards}))


def make_dataset(folder: Path, shards: Mapping[str, Sequence[int]] = ONE_SHARD, rows_per_group: int = 1) -> Path:
    """A dataset of frames of these numbers, by shard; returns its folder."""
    for name, ids in shards.items():
        write(folder / f"{name}.parquet", [make_frame(index) for index in ids], rows_per_group=rows_per_group)
    write_manifest(folder, {f"{name}.parquet": len(ids) for name, ids in shards.items()})
    return folder


def values(dataset: Dataset) -> list[tuple[int, bytes, bytes]]:
    """What the training frames of a dataset hold."""
    return [(f.frame_id, f.image.tobytes(), f.range_channel.tobytes()) for f in dataset.frames("train")]


def make_traced(folder: Path) -> Path:
    """What ``datafactory trace`` leaves: shards of paths and no frames."""
    path = folder / "paths" / "part-00000.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table({"frame_id": [0, 1]}), path)
    write_manifest(folder, {"paths/part-00000.parquet": 2})
    return folder
