"""Shards to tensors: the values of the shard, its dtypes, and workers that start cleanly."""

import pickle

import numpy as np
import pytest
import torch
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem
from small_dataset import CHANNELS, PEAKS, ROWS, make_dataset, make_frame
from torch.utils.data import DataLoader

from shared.dataset.locations import RemotePath
from shared.physics.errors import InputError
from trainer.data.shards import ShardDataset


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
    assert set(item) == {"image", "image_peak", "noise_power", "frame_id"}


def test_workers_give_the_frames_of_one_process(directory):
    data = ShardDataset(directory, "train")
    alone = list(DataLoader(data, batch_size=2))
    loader = DataLoader(data, batch_size=2, num_workers=1, multiprocessing_context="spawn")
    batches = list(loader)
    assert [batch["frame_id"].tolist() for batch in batches] == [[0, 1], [2, 3], [4]]
    assert batches[0]["range_channel"].shape == (2, PEAKS, ROWS, CHANNELS)
    for one, other in zip(alone, batches, strict=True):
        assert all(torch.equal(one[name], other[name]) for name in one)


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
    monkeypatch.setattr("trainer.data.shards.OPEN_SHARDS", 1)
    data = ShardDataset(directory, "train", cache_bytes=0)
    for index in (0, 4, 1, 3):
        assert data[index]["frame_id"].item() == index
        assert len(data._open) == 1


def test_frames_that_fit_are_decoded_once(directory, monkeypatch):
    one = ShardDataset(directory, "train", columns=("image",))._read(0).nbytes
    data = ShardDataset(directory, "train", columns=("image",), cache_bytes=2 * one)
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


def test_a_shard_damaged_within_is_named(directory):
    """Before it is opened by its hash, afterwards by what Parquet finds in its pages."""
    early, late = ShardDataset(directory, "train"), ShardDataset(directory, "train", cache_bytes=0)
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
        ("train", ("images",), "columns: 'images'; expected some of"),
        ("train", ("cube",), "'cube' is not stored; expected some of"),
    ],
)
def test_what_is_not_there_is_refused_at_once(directory, split, columns, message):
    with pytest.raises(InputError, match=message):
        ShardDataset(directory, split, columns)
