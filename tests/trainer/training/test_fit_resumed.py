"""``trainer fit`` killed, interrupted and resumed ends where it would have ended; what is wrong is one line.

So it is with the network of directions of arrival, whose samples are its own.
"""

import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch
from lightning.pytorch import Trainer
from safetensors.torch import load_file
from tiny_radar import RADAR, TINY, frame, small_dataset, write_dataset
from tiny_run import metrics, run

from shared.physics.errors import InputError
from shared.radar.arrays import line
from shared.signal.imaging import steering_weights
from trainer import fit, predict
from trainer.errors import Stopped
from trainer.run.configuration import CALIBRATED
from trainer.run.export import export
from trainer.run.folder import CHECKPOINT, WEIGHTS, load_imager, read_run, save_weights
from trainer.training.doa import AMPLITUDE_SPAN_DB, DoaSamples, DoaTask
from trainer.training.task import ImagingTask


@contextmanager
def killed_at(task: type, step: str, when: Callable[[Any, int], bool]) -> Iterator[None]:
    """The run within ends in this step of the task, where ``when(task, its last argument, a batch's number)``."""
    original = getattr(task, step)

    def killed(self, *given):
        if when(self, given[-1]):
            raise MemoryError("killed")
        return original(self, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, step, killed)
        with pytest.raises(MemoryError):
            yield


@pytest.mark.parametrize("imperfections", [None, CALIBRATED])
def test_a_killed_run_resumed_ends_in_the_same_weights(dataset, tmp_path, imperfections):
    changes = {"steps": 6, "augment": True, "rows": 16, "points": 1, "accumulate": 2, "imperfections": imperfections}
    config = TINY.model_copy(update=changes)
    run(dataset, tmp_path / "whole", config)
    # Within an epoch of the data and between two validations.
    with killed_at(ImagingTask, "training_step", lambda _, batch: batch == 6):
        run(dataset, tmp_path / "killed", config)
    assert metrics(tmp_path / "killed")[-1]["step"] == "2"
    run(dataset, tmp_path / "killed", config, resume=True)
    assert metrics(tmp_path / "killed") == metrics(tmp_path / "whole")
    assert (tmp_path / "killed" / WEIGHTS).read_bytes() == (tmp_path / "whole" / WEIGHTS).read_bytes()
    states = [torch.load(tmp_path / name / CHECKPOINT, weights_only=True) for name in ("killed", "whole")]
    for name, tensor in states[0]["state_dict"].items():
        assert torch.equal(tensor, states[1]["state_dict"][name]), name


def test_an_interrupted_run_says_so_and_can_be_taken_up(dataset, tmp_path, monkeypatch):
    def interrupted(self, batch, batch_index):
        raise KeyboardInterrupt

    kept = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(ImagingTask, "training_step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(dataset, tmp_path / "run")
    signal.signal(signal.SIGINT, kept)
    run(dataset, tmp_path / "run", resume=True)
    assert [row["step"] for row in metrics(tmp_path / "run")] == ["0", "2", "4"]


@pytest.mark.parametrize(
    ("owner", "step", "when"),
    [
        (ImagingTask, "validation_step", lambda task, batch: task.trainer.global_step == 4 and batch == 1),
        # Its row stands in metrics.csv by then, and comes again.
        (Trainer, "save_checkpoint", lambda trainer, _: trainer.global_step == 4),
    ],
)
def test_a_run_killed_while_it_validates_validates_again(dataset, ordinary, tmp_path, owner, step, when):
    with killed_at(owner, step, when):
        run(dataset, tmp_path / "killed")
    run(dataset, tmp_path / "killed", resume=True)
    assert metrics(tmp_path / "killed") == metrics(ordinary)
    assert (tmp_path / "killed" / WEIGHTS).read_bytes() == (ordinary / WEIGHTS).read_bytes()


def test_there_is_nothing_to_resume_in_a_new_folder(dataset, ordinary, tmp_path):
    """A batch script says --resume always: it cannot know how far the job was that was put back."""
    _, lines = run(dataset, tmp_path / "new", resume=True)
    assert lines[0] == f"nothing to resume in {tmp_path / 'new'}: begins"
    assert (tmp_path / "new" / WEIGHTS).read_bytes() == (ordinary / WEIGHTS).read_bytes()


def test_a_run_killed_while_it_noted_itself_goes_on(dataset, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    (out / "run.json.partial").write_text('{"con')
    result, _ = run(dataset, out, resume=True)
    assert read_run(out) == result
    assert (out / WEIGHTS).is_file()
    assert not list(out.glob("*.partial"))


def test_a_dataset_of_another_name_is_the_same_by_what_is_in_it(dataset, ordinary, tmp_path):
    shutil.copytree(ordinary, tmp_path / "run")
    run(shutil.copytree(dataset, tmp_path / "renamed"), tmp_path / "run", resume=True)
    other = small_dataset(tmp_path / "other", training=4)
    with pytest.raises(InputError, match=r"datasets is other \(\w{8}\), but the run in .* had data \(\w{8}\); exp"):
        run(other, tmp_path / "run", resume=True)


def test_what_a_resumed_run_must_not_change(dataset, ordinary, tmp_path):
    shutil.copytree(ordinary, tmp_path / "run")
    with pytest.raises(InputError, match=r"--resume: learning_rate is 0.5, but the run in .* had 0.003"):
        run(dataset, tmp_path / "run", TINY.model_copy(update={"learning_rate": 0.5}), resume=True)
    with pytest.raises(InputError, match=r"--resume: processes is 2, but the run in .* had 1; expected"):
        run(dataset, tmp_path / "run", devices=2, resume=True)


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


@pytest.mark.parametrize(
    ("part", "changes", "message"),
    [
        ("virtual_sensor", {"rx_m": RADAR.virtual_sensor.rx_m[:9]},
         r"virtual_sensor.rx_m = 9 positions .*; expected 17 positions .* has it"),
        ("waveform", {"bandwidth_hz": 2e9}, r"waveform.bandwidth_hz = 2000000000.0; expected 10000"),
    ],
)  # fmt: skip
def test_datasets_of_different_radars_are_not_mixed(dataset, tmp_path, part, changes, message):
    radar = RADAR.model_copy(update={part: getattr(RADAR, part).model_copy(update=changes)})
    other = small_dataset(tmp_path / "other", radar=radar)
    with pytest.raises(InputError, match=rf"other: radar 'tiny', {message}"):
        fit([dataset, other], tmp_path / "run", config=TINY, array="full")


def test_a_damaged_shard_stops_before_training_by_its_path(dataset, tmp_path):
    copy = shutil.copytree(dataset, tmp_path / "data")
    shard = copy / "train/part-00000.parquet"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    with pytest.raises(InputError, match=r"train/part-00000.parquet: sha256 is"):
        run(copy, tmp_path / "run")
    assert not (tmp_path / "run").exists()


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


DOA = TINY.model_copy(
    update={"model": "doa-cnn", "features": "covariance", "target": "doa", "width": 8, "rows": 16, "foreground": 0.0}
)
# Nine elements: the smallest array that four convolutions leave something of.
WIDE = RADAR.model_copy(update={"array": RADAR.array.model_copy(update={"rx_m": line(2e-3 * np.arange(9.0))})})


def test_samples_hold_one_to_three_targets_at_the_stated_levels():
    item = DoaSamples(RADAR, seed=1, size=8, rows=400)[3]
    truth, snapshot = item["truth"].numpy(), item["range_channel"][0].numpy()
    counts = truth.sum(axis=1)
    assert set(counts) == {1.0, 2.0, 3.0}
    # Amplitudes from 0 to 20 dB: a row's power is at most that of three in phase, plus noise at -3 dB or less.
    power_db = 10 * np.log10((np.abs(snapshot) ** 2).mean(axis=1))
    assert power_db[counts == 1].min() > -1.0
    assert power_db.max() < AMPLITUDE_SPAN_DB + 20 * np.log10(3) + 1.0
    # A single target stands where the truth says: delay-and-sum peaks there.
    weights = steering_weights(RADAR, np.arange(6))
    single = np.flatnonzero(counts == 1)
    peaks = np.abs(snapshot[single] @ weights).argmax(axis=1)
    assert np.mean(np.abs(peaks - truth[single].argmax(axis=1)) <= 1) > 0.8


def test_samples_are_a_function_of_seed_and_index():
    one, two = DoaSamples(RADAR, 1, 8, 5), DoaSamples(RADAR, 2, 8, 5)
    assert torch.equal(one[3]["range_channel"], one[3]["range_channel"])
    assert not torch.equal(one[3]["range_channel"], one[4]["range_channel"])
    assert not torch.equal(one[3]["range_channel"], two[3]["range_channel"])


def test_it_trains_resumes_predicts_and_exports(tmp_path):
    frames = {"train": [frame(0, WIDE)], "validation": [frame(1, WIDE)], "test": [frame(2, WIDE)]}
    data = write_dataset(tmp_path / "data", frames, WIDE)
    lines: list[str] = []
    fit([data], tmp_path / "whole", config=DOA, array="full", announce=lines.append)
    assert lines[0].endswith("array full; point targets drawn anew, no frames")
    with killed_at(DoaTask, "training_step", lambda _, batch: batch == 3):
        fit([data], tmp_path / "killed", config=DOA, array="full", announce=lines.append)
    fit([data], tmp_path / "killed", config=DOA, array="full", resume=True, announce=lines.append)
    states = [torch.load(tmp_path / name / CHECKPOINT, weights_only=True) for name in ("whole", "killed")]
    for key, tensor in states[0]["state_dict"].items():
        assert torch.equal(tensor, states[1]["state_dict"][key]), key
    assert predict([tmp_path / "whole", data], tmp_path / "images", announce=lines.append) == 1
    assert export(tmp_path / "whole", tmp_path / "doa.onnx").difference <= 1e-4
