"""``trainer fit`` says in one line what is wrong with its data, its weights, its start."""

import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from small_fit import run
from tiny_radar import RADAR, TINY, frame, small_dataset, write_dataset

from shared.physics.errors import InputError
from trainer import fit
from trainer.errors import Stopped
from trainer.run.folder import WEIGHTS, load_imager, save_weights


def test_an_infinite_input_stops_with_its_frame_and_keeps_the_weights(dataset, tmp_path, monkeypatch):
    from trainer.training import datamodule

    class Damaged(datamodule.ShardDataset):
        def __getitem__(self, index):
            item = super().__getitem__(index)
            if item["frame_id"] == 5:
                item["range_channel"][0, 3, 1] = np.inf
            return item

    monkeypatch.setattr(datamodule, "ShardDataset", Damaged)
    with pytest.raises(Stopped, match=r"loss is not finite for frame \[5\] at batch \d; the weights are"):
        run(dataset, tmp_path / "run", TINY.model_copy(update={"steps": 8, "validate_every": 1}))
    if (tmp_path / "run" / WEIGHTS).is_file():
        assert all(torch.isfinite(tensor).all() for tensor in load_file(tmp_path / "run" / WEIGHTS).values())


def test_truths_of_other_virtual_sensors_are_not_mixed(dataset, tmp_path):
    sensor = RADAR.virtual_sensor.model_copy(update={"rx_m": RADAR.virtual_sensor.rx_m[:9]})
    other = small_dataset(tmp_path / "other", radar=RADAR.model_copy(update={"virtual_sensor": sensor}))
    with pytest.raises(InputError, match=r"virtual_sensor.rx_m = 9 positions .*; expected 17 positions .* has it"):
        fit([dataset, other], tmp_path / "run", config=TINY)


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
        fit([dataset, second], tmp_path / "run", config=TINY, array="full")


def test_weights_that_are_no_whole_network_of_the_run_are_named(dataset, ordinary, tmp_path):
    shutil.copytree(ordinary, tmp_path / "run")
    run(dataset, tmp_path / "wider", TINY.model_copy(update={"width": 8}))
    path, executed = tmp_path / "run" / WEIGHTS, tmp_path / "executed"
    whole = path.read_bytes()
    imager = load_imager(tmp_path / "run")[1]

    class Trap:
        def __reduce__(self):
            return open, (str(executed), "w")

    def pickled():
        torch.save(Trap(), path)

    def not_finite():
        with torch.no_grad():
            next(imager.parameters()).fill_(torch.nan)
        save_weights(tmp_path / "run", imager)

    for spoil, message in (
        (lambda: path.write_bytes(whole[: len(whole) // 2]), "not readable as safetensors"),
        (pickled, "not readable as safetensors"),
        (not_finite, ".* has values that are not finite"),
        (
            lambda: path.write_bytes((tmp_path / "wider" / WEIGHTS).read_bytes()),
            r".* is float32 \[16\]; expected float32",
        ),
        (path.unlink, "no such file"),
    ):
        spoil()
        with pytest.raises(InputError, match=f"weights.safetensors: {message}"):
            load_imager(tmp_path / "run")
    assert not executed.exists()
