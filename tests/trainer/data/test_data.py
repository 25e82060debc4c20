"""Shards to tensors: the values of the shard, its dtypes, and workers that start cleanly."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem
from small_dataset import make_dataset, make_frame
from tiny_radar import RADAR, frame, small_dataset, write_dataset
from torch.utils.data import DataLoader

from shared.dataset import Box
from shared.dataset.locations import RemotePath
from shared.physics.errors import InputError
from trainer.data.dataset import RadarDataset, ShardDataset
from trainer.run.folder import SceneRecord, scene_records


@pytest.fixture
def directory(tmp_path):
    """Two shards, each one group of rows."""
    shards = {"train/part-00000": (0, 1, 2), "train/part-00001": (3, 4)}
    return make_dataset(tmp_path, shards, rows_per_group=3)


def test_every_frame_comes_with_its_values_and_types(directory):
    data = ShardDataset(directory, "train", columns=("range_channel", "velocity", "image"))
    assert len(data) == 5
    for index in (4, 0, 3, 1, 2):
        frame, item = make_frame(index), data[index]
        assert item["range_channel"].dtype == torch.complex64
        for name in ("range_channel", "velocity", "image"):
            np.testing.assert_array_equal(item[name].numpy(), getattr(frame, name))
        for name in ("image_peak", "noise_power"):
            assert item[name].dtype == torch.float64
            assert item[name].item() == getattr(frame, name)
        assert item["frame_id"].item() == index
    with pytest.raises(IndexError):
        data[5]


def test_tensors_may_be_written_without_touching_the_next_reading(directory):
    data = ShardDataset(directory, "train")
    data[1]["image"].zero_()
    np.testing.assert_array_equal(data[1]["image"].numpy(), make_frame(1).image)


def test_only_the_columns_asked_for_are_there(directory):
    item = ShardDataset(directory, "train", columns=("image",))[0]
    assert set(item) == {"image", "image_peak", "noise_power", "frame_id", "sensor_velocity", "sensor_orientation"}


def test_a_dataset_that_was_used_can_be_pickled(directory):
    data = ShardDataset(directory, "train")
    first = data[0]
    again = pickle.loads(pickle.dumps(data))
    assert torch.equal(again[0]["image"], first["image"])
    assert again.description == data.description
    place = RemotePath(SubTreeFileSystem(str(directory), LocalFileSystem()), "", "memory://set")
    remote = pickle.loads(pickle.dumps(ShardDataset(place, "train")))
    assert torch.equal(remote[4]["range_channel"], data[4]["range_channel"])


def test_few_shards_stay_open(directory, monkeypatch):
    monkeypatch.setattr("trainer.data.dataset.OPEN_SHARDS", 1)
    monkeypatch.setattr("trainer.data.dataset.CACHE_BYTES", 0)
    data = ShardDataset(directory, "train")
    for index in (0, 4, 1, 3):
        assert data[index]["frame_id"].item() == index
        assert len(data._open) == 1


def test_frames_that_fit_are_decoded_once(directory, monkeypatch):
    one = ShardDataset(directory, "train", columns=("image",))._read(0).nbytes
    monkeypatch.setattr("trainer.data.dataset.CACHE_BYTES", 2 * one)
    data = ShardDataset(directory, "train", columns=("image",))
    read: list[int] = []

    def counted(self, index):
        read.append(index)
        return READ(self, index)

    monkeypatch.setattr(ShardDataset, "_read", counted)
    for index in (3, 1, 4, 3, 1, 4, 4):
        np.testing.assert_array_equal(data[index]["image"].numpy(), make_frame(index).image)
    assert read == [3, 1, 4, 4, 4]
    again = pickle.loads(pickle.dumps(data))
    assert len(again._kept) == 0
    assert again._room == 2 * one


READ = ShardDataset._read


def test_a_shard_damaged_within_is_named(directory, monkeypatch):
    """Before it is opened by its hash, afterwards by what Parquet finds in its pages."""
    monkeypatch.setattr("trainer.data.dataset.CACHE_BYTES", 0)
    early, late = (ShardDataset(directory, "train") for _ in range(2))
    late[3]
    path = directory / "train/part-00001.parquet"
    content = bytearray(path.read_bytes())
    content[4 : len(content) // 8] = bytes(len(content) // 8 - 4)  # the first columns; the footer stays
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"part-00001.parquet: sha256 is"):
        early[3]
    with pytest.raises(InputError, match=r"part-00001.parquet: damaged"):
        late[3]


@pytest.mark.parametrize(
    ("split", "columns", "message"),
    [
        ("test", ("image",), "no frames in split 'test'"),
        ("train", ("cube",), "'cube' is not stored; expected some of"),
    ],
)
def test_what_is_not_there_is_refused_at_once(directory, split, columns, message):
    with pytest.raises(InputError, match=message):
        ShardDataset(directory, split, columns)


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


def test_an_array_chooses_the_channels(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("rx = [0, 2, 5]", encoding="utf-8")
    small_dataset(tmp_path / "data")
    whole, part = (RadarDataset(tmp_path / "data", array=array) for array in ("full", str(tmp_path / "mine.toml")))
    np.testing.assert_array_equal(part.channels, [0, 2, 5])
    torch.testing.assert_close(part[0].input, whole[0].input[..., [0, 2, 5]], rtol=0.0, atol=0.0)


def test_an_array_that_is_no_name_and_an_index_that_is_no_number_are_told_in_a_line(tmp_path: Path) -> None:
    folder = small_dataset(tmp_path / "data")
    with pytest.raises(InputError, match=r"^array: \[0, 2\]; expected a name, or the path of a TOML file"):
        RadarDataset(folder, array=[0, 2])  # type: ignore[arg-type]
    data = RadarDataset(folder)
    wrong: tuple[Any, ...] = (slice(0, 2), 1.0, "a", None)
    for index in wrong:
        with pytest.raises(InputError, match=r"^index: .*; expected a whole number; several frames are torch"):
            data[index]
    whole: tuple[Any, ...] = (np.int64(1), torch.tensor(1))
    assert [data[index].metadata["frame_id"] for index in (*whole, -1)] == [1, 1, len(data) - 1]


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
    alone = DataLoader(data, batch_size=4)
    workers = DataLoader(data, batch_size=4, num_workers=1, multiprocessing_context="spawn")
    for here, there in zip(alone, workers, strict=True):
        assert here.input.shape == (4, *data[0].input.shape)
        torch.testing.assert_close(here.input, there.input, rtol=0.0, atol=0.0)
        assert here.metadata["scene"] == ["none"] * 4
        assert here.metadata["noise_power"].dtype == torch.float64
        assert here.metadata["sensor_orientation"].shape == (4, 4)


MUNICH = {"name": "munich", "content_sha256": "a" * 64, "source": "sionna:munich", "triangles": 38936}


def test_a_scene_has_its_name_its_content_and_what_was_put_in():
    crowded = {**MUNICH, "content_sha256": "b" * 64, "population": {"populate": "cars=20", "seed": 0}}
    assert scene_records({"scenes": [MUNICH, crowded]}) == (
        SceneRecord(name="munich", content_sha256="a" * 64),
        SceneRecord(name="munich", content_sha256="b" * 64, populate="cars=20"),
    )


def test_no_scenes_are_not_unknown_ones():
    assert scene_records({"scenes": []}) == ()
    assert scene_records({}) is None


@pytest.mark.parametrize(
    "scenes",
    [
        "munich", ["munich"], [{**MUNICH, "name": 7}], [{**MUNICH, "population": "many"}], [MUNICH, {}],
    ],
)  # fmt: skip
def test_what_cannot_be_understood_is_unknown(scenes):
    assert scene_records({"scenes": scenes}) is None
