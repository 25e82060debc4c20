"""Several training processes: who writes, who ends with whom; each its part of every batch, the same weights."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import torch
from command_line import ended
from processes import wait_for
from tiny_radar import small_dataset

from shared.physics.errors import InputError
from trainer.run.folder import CHECKPOINT, METRICS
from trainer.training.processes import launched

SIZE = ("--width", "4", "--rows", "16", "--array", "full")
STEPS, EVERY = 60, 5
LONGEST_S = 120.0
"""Until the first checkpoint, or from the signal to the end."""
INTERRUPTED = "trainer: interrupted; the same command with --resume goes on from the last checkpoint"
GONE = "trainer: --devices: a training process ended by {}; expected 2 that go on; --resume goes on from the last check"


def fit(folder: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "trainer", "fit", str(folder / "data"), "--out", str(folder / "run"), *SIZE]
    command += ["--batch", "2", "--devices", "2", "--steps", str(STEPS), "--validate-every", str(EVERY), *more]
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
    wait_for((tmp_path / "run" / CHECKPOINT).is_file, LONGEST_S, process)
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


TORCHRUN = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", 2)


@pytest.mark.slow
@pytest.mark.parametrize(("launcher", "more"), [((), ("--devices", 2)), (TORCHRUN, ())], ids=["devices", "torchrun"])
def test_two_processes_train_what_one_trains(
    tmp_path: Path, launcher: tuple[object, ...], more: tuple[object, ...]
) -> None:
    """Two processes with a batch of 2 each against one with a batch of 4: equal but for the order of sums. Without a
    word about devices where torchrun has said how many there are.

    Held to the relative norm over all weights, because Adam turns the rounding of a gradient near zero into a step
    of that one weight. Measured: 3.5e-5; one process with a batch of 2, i.e. half of the data, differs by 1.6e-2.
    Processes whose weights drift apart, or that see the same frames, do not give what one gives.
    """
    arguments = ("fit", small_dataset(tmp_path / "data"), *SIZE, "--steps", 4, "--validate-every", 4)
    code, _, line = ended("trainer", *arguments, "--batch", 4, "--out", tmp_path / "one")
    assert code == 0, line
    command = (sys.executable, *launcher, "-m", "trainer", *arguments, "--batch", 2, "--out", tmp_path / "two", *more)
    done = subprocess.run(
        [str(part) for part in command], env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    # The best weights may be the first; the last have seen all steps.
    one, two = (torch.load(tmp_path / name / CHECKPOINT, weights_only=True)["state_dict"] for name in ("one", "two"))
    difference = torch.cat([(two[name] - one[name]).flatten() for name in one])
    assert difference.norm() <= 1e-3 * torch.cat([weight.flatten() for weight in one.values()]).norm()
    # A heading, and the validation before the first step.
    assert [(tmp_path / name / METRICS).read_text().count("\n") for name in ("one", "two")] == [3, 3]
    assert done.stdout.count("step 4 ") == done.stdout.count("run in ") == 1


def test_devices_are_what_torchrun_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    assert launched(3) == (3, 1)
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "run")
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "4")
    monkeypatch.setenv("WORLD_SIZE", "12")
    assert launched(1) == launched(4) == (4, 3)
    with pytest.raises(InputError, match=r"^--devices: 2, but torchrun has started 4 on this machine; expected 4, or"):
        launched(2)
