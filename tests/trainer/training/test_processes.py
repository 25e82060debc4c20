"""Two training processes of which one is ended: one line, nothing left running, and a run that can be taken up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from tiny_radar import small_dataset

from trainer.run.folder import CHECKPOINT, METRICS

SIZE = ["--width", "4", "--hidden", "16", "--rows", "16", "--batch", "2", "--array", "full", "--devices", "2"]
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
