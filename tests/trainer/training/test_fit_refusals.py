"""``trainer fit`` says in one line what is wrong with its data, its weights, its start."""

import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from small_fit import run
from tiny_radar import RADAR, TINY, frame, write_dataset

from shared.physics.errors import InputError
from trainer.errors import TrainingStopped
from trainer.run.folder import WEIGHTS, load_imager
from trainer.training.fit import FitRequest, fit


def test_an_infinite_input_stops_with_its_frame_and_keeps_the_weights(dataset, tmp_path, monkeypatch):
    from trainer.training import datamodule

    class Damaged(datamodule.ShardDataset):
        def __getitem__(self, index):
            item = super().__getitem__(index)
            if item["frame_id"] == 5:
                item["range_channel"][0, 3, 1] = np.inf
            return item

    monkeypatch.setattr(datamodule, "ShardDataset", Damaged)
    with pytest.raises(TrainingStopped, match=r"loss is not finite for frame \[5\] at batch \d; the weights are"):
        run(dataset, tmp_path / "run", TINY.model_copy(update={"steps": 8, "validate_every": 1}))
    if (tmp_path / "run" / WEIGHTS).is_file():
        assert all(torch.isfinite(tensor).all() for tensor in load_file(tmp_path / "run" / WEIGHTS).values())


def test_a_damaged_shard_stops_before_training_by_its_path(dataset, tmp_path):
    copy = shutil.copytree(dataset, tmp_path / "data")
    shard = copy / "train/part-00000.parquet"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    with pytest.raises(InputError, match=r"train/part-00000.parquet: sha256 is"):
        run(copy, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_datasets_of_different_radars_are_not_mixed(dataset, tmp_path):
    other = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"bandwidth_hz": 2e9})})
    frames = {"train": [frame(0, other)], "validation": [frame(1, other)]}
    second = write_dataset(tmp_path / "other", frames, other)
    with pytest.raises(InputError, match=r"other: radar 'tiny', waveform.bandwidth_hz = 2000000000.0; expected 10000"):
        fit(FitRequest([dataset, second], tmp_path / "run", TINY, array="full"))


def test_a_run_does_not_begin_with_another_network(dataset, tmp_path):
    run(dataset, tmp_path / "first")
    with pytest.raises(InputError, match=r"--from: .*first has width = 4; expected 8"):
        run(dataset, tmp_path / "second", TINY.model_copy(update={"width": 8}), start=tmp_path / "first")
    with pytest.raises(InputError, match=f"none/{WEIGHTS}: no such file"):
        run(dataset, tmp_path / "third", start=tmp_path / "none")
    assert not (tmp_path / "third").exists() or not any((tmp_path / "third").iterdir())


def test_weights_that_are_cut_short_or_foreign_are_named(dataset, tmp_path):
    run(dataset, tmp_path / "run")
    path = tmp_path / "run" / WEIGHTS
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"weights.safetensors: not readable as safetensors"):
        load_imager(tmp_path / "run")
    run(dataset, tmp_path / "wider", TINY.model_copy(update={"width": 8}))
    path.write_bytes((tmp_path / "wider" / WEIGHTS).read_bytes())
    with pytest.raises(InputError, match=r"decoder.0.first.bias is float32 \[16\]; expected float32 \[8\]"):
        load_imager(tmp_path / "run")
    path.unlink()
    with pytest.raises(InputError, match="no such file"):
        load_imager(tmp_path / "run")
    with pytest.raises(InputError, match=r"no run.json"):
        load_imager(tmp_path)


@pytest.mark.parametrize(("weights", "message"), [((1.0, 2.0), "2 weights for 1 datasets"), ((0.0,), "above 0")])
def test_bad_weights_are_refused(dataset, tmp_path, weights, message):
    with pytest.raises(InputError, match=message):
        run(dataset, tmp_path / "run", weights=weights)
