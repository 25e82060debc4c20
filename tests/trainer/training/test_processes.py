"""Several training processes: who writes, who ends with whom; each its part of every batch, the same weights."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import torch
from tiny_radar import small_dataset

from shared.physics.errors import InputError
from trainer.run.folder import CHECKPOINT, METRICS
from trainer.training.processes import launched

SIZE = ["--width", "4", "--rows", "16", "--batch", "2", "--array", "full", "--devices", "2"]
STEPS, EVERY = 60, 5
LONGEST_S = 120.0
"""Until the first checkpoint, or from the signal to the end."""
INTERRUPTED = "trainer: interrupted; the same command with --resume goes on from the last checkpoint"
GONE = "trainer: --devices: a training process ended by {}; expected 2 that go on; --resume goes on from the last check"


def fit(folder: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "trainer", "fit", str(folder / "data"), "--out", str(folder / "run"), *SIZE]
    command += ["--steps", str(STEPS), "--validate-every", str(EVERY), *more]
    return subprocess.Popen(
        command, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("whom", "how", "status", "said", "resumes"),
    [
        ("first", signal.SIGTERM, 130, [INTERRUPTED], False),
        ("group", signal.SIGINT, 130, [INTERRUPTED], True),
        ("second", signal.SIGTERM, 1, [GONE.format("SIGTERM")], False),
        ("first", signal.SIGKILL, -signal.SIGKILL, [], False),
    ],
)
def test_one_of_two_processes_is_ended(
    tmp_path: Path, whom: str, how: signal.Signals, status: int, said: list[str], resumes: bool
) -> None:
    """Nearly all of its time is the start of processes, six seconds each: one case is resumed, and a follower is ended
    by the signal that it is told how to answer."""
    small_dataset(tmp_path / "data")
    process = fit(tmp_path)
    end = time.monotonic() + LONGEST_S
    while not (tmp_path / "run" / CHECKPOINT).is_file():
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.02)
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    assert len(family) == 2
    for one in {"first": family[:1], "second": family[1:], "group": family}[whom]:
        one.send_signal(how)
    _, text = process.communicate(timeout=LONGEST_S)
    lines = [line for line in text.splitlines() if not line.startswith("Initializing distributed")]
    assert process.returncode == status, text
    assert len(lines) == len(said), text
    assert all(line.startswith(begin) for line, begin in zip(lines, said, strict=True)), text
    assert not psutil.wait_procs(family, timeout=10.0)[1]
    if resumes:
        resumed = fit(tmp_path, "--resume")
        _, text = resumed.communicate(timeout=LONGEST_S)
        assert resumed.returncode == 0, text
        # A heading, and the validation before the first step.
        assert (tmp_path / "run" / METRICS).read_text().count("\n") == 2 + STEPS // EVERY


WATCHED = """
import sys
from pathlib import Path

import torch
from trainer.cli.app import app
from trainer.training import fit

folder = Path(sys.argv.pop(1))


class Watched(fit.ImagingTask):
    def on_fit_start(self):
        self.seen = []

    def training_step(self, batch, index):
        self.seen.append(batch["image"])
        return super().training_step(batch, index)

    def on_train_end(self):
        torch.save((self.seen, self.state_dict()), folder / f"rank-{self.global_rank}.pt")


fit.ImagingTask = Watched
app()
"""
TORCH_STEPS, BATCH, FRAMES = 8, 2, 8
"""Two epochs: each step takes two frames in each of two processes."""


@pytest.mark.slow
def test_two_processes_of_torchrun_train_one_network(tmp_path: Path) -> None:
    """Without a word about devices: torchrun has said how many there are."""
    data, script, out = small_dataset(tmp_path / "data"), tmp_path / "watched.py", tmp_path / "run"
    script.write_text(WATCHED, encoding="utf-8")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", script, tmp_path]
    command += ["fit", data, "--out", out, "--width", "4", "--rows", "16", "--array", "full"]
    command += ["--batch", BATCH, "--steps", TORCH_STEPS, "--validate-every", TORCH_STEPS // 2, "--accumulate", 1]
    done = subprocess.run(
        [str(part) for part in command], env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (first, weights), (second, others) = (
        torch.load(tmp_path / f"rank-{rank}.pt", weights_only=True) for rank in (0, 1)
    )
    assert weights.keys() == others.keys()
    assert all(torch.equal(weights[name], others[name]) for name in weights)
    # An epoch shows every frame once, half of them to each process.
    assert len(first) == len(second) == TORCH_STEPS
    epoch = torch.cat([*first[: FRAMES // (2 * BATCH)], *second[: FRAMES // (2 * BATCH)]]).flatten(1)
    assert len(torch.unique(epoch, dim=0)) == FRAMES
    # A heading, and the validation before the first step.
    assert (out / METRICS).read_text(encoding="utf-8").count("\n") == 4
    assert done.stdout.count("step 4 ") == done.stdout.count("run in ") == 1


def test_devices_are_what_torchrun_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    assert launched(3) == (3, 1)
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "run")
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "4")
    monkeypatch.setenv("WORLD_SIZE", "12")
    assert launched(1) == launched(4) == (4, 3)
    with pytest.raises(InputError, match=r"^--devices: 2, but torchrun has started 4 on this machine; expected 4, or"):
        launched(2)
