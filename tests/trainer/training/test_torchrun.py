"""Two processes that torchrun has started: each its part of every batch, the same weights, one that writes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tiny_radar import small_dataset

from shared.physics.errors import InputError
from trainer.run.folder import METRICS
from trainer.training.processes import launched

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
STEPS, BATCH, FRAMES = 8, 2, 8
"""Two epochs: each step takes two frames in each of two processes."""


@pytest.mark.slow
def test_two_processes_of_torchrun_train_one_network(tmp_path: Path) -> None:
    """Without a word about devices: torchrun has said how many there are."""
    data, script, out = small_dataset(tmp_path / "data"), tmp_path / "watched.py", tmp_path / "run"
    script.write_text(WATCHED, encoding="utf-8")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", script, tmp_path]
    command += ["fit", data, "--out", out, "--width", "4", "--hidden", "16", "--rows", "16", "--array", "full"]
    command += ["--batch", BATCH, "--steps", STEPS, "--validate-every", STEPS // 2, "--accumulate", 1]
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
    assert len(first) == len(second) == STEPS
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
