"""Commands whose processes are killed: one line, nothing stays behind, the same command with --resume goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import psutil
import pytest
from command_line import ended
from processes import have_ended, wait_for
from small_evaluation import make_data
from tiny_radar import small_dataset

from trainer.run.folder import JOB

SIZE = ["--width", "4", "--rows", "16", "--validate-every", "4", "--array", "full", "--points", "0"]
INTERRUPTED = "trainer: interrupted"


@contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, ended at the end whatever happens."""
    command = [sys.executable, "-m", "trainer", *map(str, arguments)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def descendants(process: subprocess.Popen[str]) -> list[psutil.Process]:
    return psutil.Process(process.pid).children(recursive=True)


@pytest.mark.slow
def test_an_evaluation_that_is_killed(tmp_path):
    """By SIGTERM, by the death of a worker, by SIGKILL; beside it a second one is refused at once."""
    data, out = make_data(tmp_path / "data"), tmp_path / "out"
    chosen = ["--arrays", "full", "--methods", "das,omp", "--experiments", "resolution"]
    arguments = ["evaluate", data, "--out", out, *chosen]
    many = [*arguments, "--trials", "4000", "--workers", "2"]
    with started(*many) as process:
        wait_for(lambda: (out / JOB / "workers").is_dir() and len(descendants(process)) > 2)
        code, _, line = ended("trainer", *arguments, "--resume")
        assert (code, line.count("\n")) == (2, 1)
        assert line.startswith(f"trainer: --out: another process is at work in {out}; expected to wait")
        workers = descendants(process)
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=60)[1].startswith(INTERRUPTED)
        assert process.returncode == 130
    wait_for(lambda: have_ended(workers))
    assert not (out / JOB).exists()
    with started(*many, "--resume") as process:
        wait_for(lambda: (out / JOB / "workers").is_dir() and len(descendants(process)) > 2)
        workers = descendants(process)
        process.kill()
        process.wait()
    wait_for(lambda: have_ended(workers))
    (out / "figures").mkdir(exist_ok=True)
    (out / "figures/resolution.png.partial").write_bytes(b"half a picture")
    code, _, line = ended("trainer", *arguments, "--trials", "2", "--workers", "1", "--resume")
    assert (code, line) == (0, "")
    assert not (out / JOB).exists()
    assert not list(out.rglob("*.partial"))


@pytest.mark.slow
def test_a_training_that_is_killed(tmp_path):
    data, out = small_dataset(tmp_path / "data"), tmp_path / "run"
    arguments = ["fit", data, "--out", out, *SIZE, "--steps", "100000"]
    with started(*arguments, "--workers", "1") as process:
        wait_for((out / "last.ckpt").is_file)
        code, _, line = ended("trainer", *arguments, "--resume")
        assert (code, line.count("\n")) == (2, 1)
        assert line.startswith(f"trainer: --out: another process is at work in {out}; expected to wait")
        readers = descendants(process)
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=60)[1]
        assert said.startswith(INTERRUPTED)
        assert said.count("\n") == 1
        assert process.returncode == 130
    wait_for(lambda: have_ended(readers))
    assert not (out / JOB).exists()
    lines = (out / "metrics.csv").read_text().count("\n")
    with started(*arguments, "--workers", "1", "--resume") as process:
        wait_for(lambda: (out / "metrics.csv").read_text().count("\n") > lines)
        readers = descendants(process)
        assert readers
        process.kill()
        process.wait()
    wait_for(lambda: have_ended(readers))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_the_command_is_being_loaded_is_one_line(tmp_path, how):
    """Python itself answers an interrupt within its first tenth of a second, before any of our code runs."""
    with started("evaluate", tmp_path, "--out", tmp_path / "out") as process:
        wait_for(lambda: any("numpy" in found.path for found in psutil.Process(process.pid).memory_maps()))
        process.send_signal(how)
        said = process.communicate(timeout=60)[1]
    assert said.startswith(INTERRUPTED)
    assert said.count("\n") == 1
    assert process.returncode == 130
    assert not (tmp_path / "out").exists()
