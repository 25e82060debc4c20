"""``trainer fit`` killed, interrupted and resumed ends where it would have ended."""

import shutil
import signal

import pytest
import torch
from small_fit import metrics, run
from tiny_radar import TINY, small_dataset

from shared.physics.errors import InputError
from trainer.run.configuration import CALIBRATED
from trainer.run.folder import CHECKPOINT, WEIGHTS, read_run
from trainer.training.task import ImagingTask


@pytest.mark.parametrize("imperfections", [None, CALIBRATED])
def test_a_killed_run_resumed_ends_in_the_same_weights(dataset, tmp_path, monkeypatch, imperfections):
    changes = {"steps": 6, "augment": True, "rows": 16, "points": 1, "accumulate": 2, "imperfections": imperfections}
    config = TINY.model_copy(update=changes)
    run(dataset, tmp_path / "whole", config)
    original = ImagingTask.training_step

    def killed(self, batch, batch_index):
        if batch_index == 6:  # within an epoch of the data and between two validations
            raise MemoryError("killed")
        return original(self, batch, batch_index)

    monkeypatch.setattr(ImagingTask, "training_step", killed)
    with pytest.raises(MemoryError):
        run(dataset, tmp_path / "killed", config)
    monkeypatch.undo()
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


def test_a_run_killed_while_it_validates_validates_again(dataset, ordinary, tmp_path, monkeypatch):
    original = ImagingTask.validation_step

    def killed(self, batch, batch_index):
        if self.trainer.global_step == 4 and batch_index == 1:
            raise MemoryError("killed")
        return original(self, batch, batch_index)

    with monkeypatch.context() as patched:
        patched.setattr(ImagingTask, "validation_step", killed)
        with pytest.raises(MemoryError):
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
