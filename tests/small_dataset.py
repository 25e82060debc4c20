"""A dataset of three frames, made in no time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from shared.dataset import Frame, arrow_schema, description, to_record_batch
from shared.dataset.locations import sha256_of
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform

RADAR = Radar(
    waveform=Waveform(chirps=2, samples=8, range_bins=6),
    array=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(4))),
    grid=ImageGrid(bins=5),
    virtual_sensor=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(8))),
)


def make_frame(frame_id: int) -> Frame:
    generator = np.random.default_rng(frame_id)
    pairs = generator.standard_normal((3, 6, 4, 2)).astype(np.float32)
    return Frame(
        frame_id, "points", "none", frame_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
        range_channel=pairs.view(np.complex64)[..., 0],
        velocity=generator.random((3, 6), np.float32),
        image=generator.random((6, 5), np.float32),
        image_peak=1e-7,
        noise_power=1e-16,
    )  # fmt: skip


def make_dataset(directory: Path) -> Path:
    """Write it; returns its folder."""
    shard = directory / "train/part-00000.parquet"
    shard.parent.mkdir(parents=True)
    schema = arrow_schema(description(RADAR, 3, "range-channel"))
    rows = [make_frame(index) for index in range(3)]
    pq.write_table(pa.Table.from_batches([to_record_batch(rows, schema)]), shard, row_group_size=1)
    record = {"path": "train/part-00000.parquet", "rows": 3, "bytes": shard.stat().st_size, "sha256": sha256_of(shard)}
    (directory / "manifest.json").write_text(json.dumps({"version": 1, "shards": [record]}))
    return directory
