"""What nobody should type, files that nobody should trust, and processes that are killed: one line, and no traceback.

Of what was killed nothing stays behind, and the same command with --resume goes on.
"""

import io
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
import torch
from command_line import ended, refused
from numpy_bytes import npz
from processes import have_ended, wait_for
from small_evaluation import FULL, make_data, make_run
from tiny_radar import RADAR, small_dataset

from shared.dataset.documents import sealed
from trainer.run.folder import JOB

SIZE = ["--width", "4", "--rows", "16", "--steps", "4", "--validate-every", "2", "--array", "full"]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return small_dataset(tmp_path_factory.mktemp("data") / "data")


def test_a_run_that_is_nested_deeply_or_asks_for_much_is_one_line(tmp_path, data):
    run = make_run(tmp_path / "run", FULL, RADAR)
    document = json.loads((run / "run.json").read_text())
    for text, message in (
        ("[" * 200_000, "not readable as JSON"),
        (json.dumps(document | {"version": 2}), "version = 2"),
        (json.dumps(sealed(document | {"config": document["config"] | {"width": 10**9}})), "config.width = 1000000000"),
    ):
        (run / "run.json").write_text(text)
        line = refused("trainer", "predict", run, data, "--out", tmp_path / "out")
        assert line.startswith(f"trainer: {run}/run.json: {message}"), line


def test_a_manifest_that_is_nested_deeply_is_one_line(tmp_path):
    (tmp_path / "manifest.json").write_text('{"a":' * 200_000)
    line = refused("trainer", "fit", tmp_path, "--out", tmp_path / "out")
    assert line.startswith(f"trainer: {tmp_path}/manifest.json: not readable as JSON")


class Trap:
    """Opens a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_a_checkpoint_of_something_else_is_one_line_that_names_it(tmp_path, data):
    run = tmp_path / "run"
    assert ended("trainer", "fit", data, "--out", run, *SIZE)[0] == 0
    path = run / "last.ckpt"
    whole = path.read_bytes()
    content = torch.load(path, weights_only=True)
    pieces = {
        "cut short": whole[: len(whole) // 2], "empty": b"", "text": b"not a checkpoint", "a zip": npz(cube=b""),
        "a bit": whole[: len(whole) // 2] + bytes([whole[len(whole) // 2] ^ 1]) + whole[len(whole) // 2 + 1 :],
    }  # fmt: skip
    changed = {
        "a list": [1, 2], "without loops": {name: content[name] for name in content if name != "loops"},
        "of another network": content | {"state_dict": {"weight": torch.zeros(3)}},
        "of other loops": content | {"loops": {"fit_loop": 3}},
        "of other optimisers": content | {"optimizer_states": [{}]},
        "code": content | {"state_dict": Trap(tmp_path / "executed")},
    }  # fmt: skip
    for name, value in changed.items():
        buffer = io.BytesIO()
        torch.save(value, buffer)
        pieces[name] = buffer.getvalue()
    for name, damaged in pieces.items():
        path.write_bytes(damaged)
        line = refused("trainer", "fit", data, "--out", run, *SIZE, "--resume")
        assert line.startswith(f"trainer: {path}: "), (name, line)
    assert not (tmp_path / "executed").exists()
    path.write_bytes(whole)
    assert ended("trainer", "fit", data, "--out", run, *SIZE, "--resume")[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("command", "largest"), [("evaluate", 30_000), ("fit", 60_000)])
def test_a_full_disk_names_the_file_and_nothing_partial_stays(tmp_path, command, largest):
    """A limit on the size of files stands for a disk that is full."""
    out, data = tmp_path / "run", tmp_path / "data"
    make_data(data) if command == "evaluate" else small_dataset(data)
    arguments = {
        "evaluate": ["--arrays", "full", "--methods", "das", "--experiments", "noise-only", "--trials", "2"],
        "fit": [*SIZE, "--width", "8"],
    }[command]
    done = subprocess.run(
        [sys.executable, "-m", "trainer", command, str(data), "--out", str(out), *arguments],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest)),
        env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith(f"trainer: {out}/")
    assert done.stderr.endswith(": File too large\n")
    assert not list(out.rglob("*.partial"))
    assert not (out / ".job").exists()


LONG_FIT = ["--width", "4", "--rows", "16", "--validate-every", "4", "--array", "full", "--points", "0"]
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
        line = refused("trainer", *arguments, "--resume")
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
    arguments = ["fit", data, "--out", out, *LONG_FIT, "--steps", "100000"]
    with started(*arguments, "--workers", "1") as process:
        wait_for((out / "last.ckpt").is_file)
        line = refused("trainer", *arguments, "--resume")
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
