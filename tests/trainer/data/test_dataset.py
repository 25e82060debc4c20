"""RadarDataset: the shard's values, the channels of an array, PyTorch's own collation."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from tiny_radar import RADAR, frame, small_dataset, write_dataset
from torch.utils.data import DataLoader

from shared.dataset import Box
from shared.dataset.documents import sealed
from shared.dataset.writing import write_json
from shared.physics.errors import InputError
from trainer.data.dataset import RadarDataset


def test_an_example_holds_the_frame(tmp_path: Path) -> None:
    stored = replace(
        frame(3), scene="hall", sensor_position=(1.0, -2.0, 0.5), sensor_velocity=(4.0, 0.0, 0.0),
        sensor_orientation=(0.6, 0.0, 0.0, 0.8), time=1.25, sequence=3,
    )  # fmt: skip
    write_dataset(tmp_path / "data", {"test": [frame(1), stored]})
    data = RadarDataset(tmp_path / "data", "test")
    assert len(data) == 2
    signal, image, metadata = data[1]
    np.testing.assert_array_equal(signal.numpy(), stored.range_channel)
    np.testing.assert_array_equal(image.numpy(), stored.image)
    np.testing.assert_array_equal(metadata["velocity"].numpy(), stored.velocity)
    for name in ("frame_id", "kind", "scene", "seed", "image_peak", "noise_power", "time", "sequence"):
        assert metadata[name] == getattr(stored, name), name
    for name in ("sensor_position", "sensor_velocity", "sensor_orientation"):
        assert metadata[name].dtype == torch.float64
        assert tuple(metadata[name].tolist()) == getattr(stored, name)
    np.testing.assert_array_equal(data.range_m, RADAR.waveform.ranges_m)
    np.testing.assert_array_equal(data.u, RADAR.grid.u)


def test_an_older_dataset_has_no_time(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data", {"test": [frame(1)]})
    (shard,) = (tmp_path / "data" / "test").iterdir()
    older = pq.read_table(shard).drop_columns(["time", "sequence"])
    pq.write_table(older, shard, row_group_size=1)
    manifest = tmp_path / "data" / "manifest.json"
    stated = json.loads(manifest.read_text())
    content = shard.read_bytes()
    stated["shards"][0] |= {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    write_json(manifest, sealed(stated))
    metadata = RadarDataset(tmp_path / "data", "test")[0].metadata
    assert math.isnan(metadata["time"])
    assert metadata["sequence"] == -1


def test_an_array_chooses_the_channels(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("rx = [0, 2, 5]", encoding="utf-8")
    small_dataset(tmp_path / "data")
    whole, part = (RadarDataset(tmp_path / "data", array=array) for array in ("full", str(tmp_path / "mine.toml")))
    np.testing.assert_array_equal(part.channels, [0, 2, 5])
    torch.testing.assert_close(part[0].input, whole[0].input[..., [0, 2, 5]], rtol=0.0, atol=0.0)


def test_boxes_are_there_for_who_asks(tmp_path: Path) -> None:
    boxes = tuple(Box((9.0, k, 0.0), (4.5, 1.8, 1.5), 0.1 * k, (0.0, 1.0, 0.0), "car", f"{k}", 1e-12) for k in (1, 2))
    write_dataset(tmp_path / "data", {"train": [replace(frame(0), boxes=boxes), frame(1)]})
    data = RadarDataset(tmp_path / "data", boxes=True)
    assert tuple(data[0].metadata["boxes"]) == boxes
    assert data[1].metadata["boxes"] == []
    (batch,) = DataLoader(data, batch_size=2, collate_fn=list)
    assert [len(example.metadata["boxes"]) for example in batch] == [2, 0]
    assert "boxes" not in RadarDataset(tmp_path / "data")[0].metadata


def test_batches_by_pytorchs_own_collation_and_in_workers(tmp_path: Path) -> None:
    data = RadarDataset(small_dataset(tmp_path / "data"))
    batches = [list(DataLoader(data, batch_size=4, num_workers=workers)) for workers in (0, 1)]
    for here, there in zip(*batches, strict=True):
        assert here.input.shape == (4, *data[0].input.shape)
        torch.testing.assert_close(here.input, there.input, rtol=0.0, atol=0.0)
        assert here.metadata["scene"] == ["none"] * 4
        assert here.metadata["noise_power"].dtype == torch.float64
        assert here.metadata["sensor_orientation"].shape == (4, 4)


def test_what_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    small_dataset(tmp_path / "data")
    with pytest.raises(InputError, match="no frames in split 'tests'"):
        RadarDataset(tmp_path / "data", "tests")
    with pytest.raises(InputError, match="no named array and no file"):
        RadarDataset(tmp_path / "data", array="sparse5")
    with pytest.raises(IndexError):
        RadarDataset(tmp_path / "data", "test")[1]
