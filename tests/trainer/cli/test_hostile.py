"""What nobody should type, and files that nobody should trust: one line, at once, and no traceback."""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy_bytes import npz, of_array
from small_evaluation import FULL, make_data, make_run
from tiny_radar import RADAR, small_dataset

from shared.dataset.documents import sealed
from trainer.cli.app import main

SIZE = ["--width", "4", "--hidden", "16", "--rows", "16", "--steps", "4", "--validate-every", "2", "--array", "full"]
SHAPE = (RADAR.waveform.chirps, RADAR.waveform.samples, RADAR.array.channels)


def status(capsys, monkeypatch, *arguments):
    """(exit status, standard error) of the command."""
    monkeypatch.setattr(sys, "argv", ["trainer", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code, capsys.readouterr().err


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return small_dataset(tmp_path_factory.mktemp("data") / "data")


SEED = "123456789012345678901234567890"
ARGUMENTS = {
    "a weight that is no number": (["fit", "DATA", "--weight", "nan"], "--weight: nan; expected numbers above 0"),
    "a weight without end": (["fit", "DATA", "--weight", "inf"], "--weight: inf; expected numbers above 0"),
    "a seed of 30 digits": (["fit", "DATA", "--seed", SEED], "Invalid value for '--seed': Input should be less than"),
    "another": (["evaluate", "DATA", "--seed", SEED], "Invalid value for '--seed': Input should be less than"),
    "a network without end": (["fit", "DATA", "--width", "1000000000"], "trainer fit: width = 1000000000; expected"),
    "a network that no machine holds": (
        ["fit", "DATA", "--width", "16000", "--array", "full"],
        "network: width = 16000, hidden = 384, bins = 20, 6 channels make 1.4e+11 weights, 2.24e+03 GB in training;",
    ),
    "a batch without end": (["fit", "DATA", "--batch", "1000000000"], "trainer fit: batch = 1000000000; expected"),
    "no methods": (["evaluate", "none", "--methods", ""], "--methods: none; expected some of das"),
    "no experiments": (["evaluate", "none", "--experiments", " , "], "--experiments: none; expected some of point-s"),
    "an unknown method": (["evaluate", "none", "--methods", "best"], "--methods: 'best'; expected some of das"),
    "no snapshot": (["evaluate", "none", "--measured", "none.mat"], "--measured: none.mat; expected a .mat or .npy"),
    "too few channels": (
        ["fit", "DATA", "--recipe", "doa", "--array", "full"], "--array: 6 channels; expected at least 9 with",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", ARGUMENTS)
def test_bad_arguments_are_said_before_any_work(data, tmp_path, capsys, monkeypatch, case):
    """Where DATA is "none" there is none: what is said comes before it is looked at."""
    given, message = ARGUMENTS[case]
    out = tmp_path / "out"
    code, line = status(capsys, monkeypatch, *(data if word == "DATA" else word for word in given), "--out", out)
    assert (code, line.count("\n")) == (2, 1), line
    assert line.startswith(f"trainer: {message}"), line
    assert not out.exists()


@pytest.mark.parametrize("command", ["fit", "evaluate", "predict"])
def test_a_folder_that_cannot_be_written_is_said_before_any_work(tmp_path, capsys, monkeypatch, command):
    file = tmp_path / "file"
    file.write_text("mine")
    places = ["none", "none"] if command == "predict" else ["none"]
    code, line = status(capsys, monkeypatch, command, *places, "--out", file / "out")
    assert code == 2
    assert line == f"trainer: --out: {file}/out: Not a directory; expected a folder that can be written\n"


def header(text: str, length: int | None = None) -> bytes:
    content = text.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + (len(content) if length is None else length).to_bytes(2, "little") + content


CUBE = of_array(np.zeros(SHAPE, np.complex64))
RADAR_TEXT = of_array(np.asarray(RADAR.model_dump_json()))


def scrambled(content: bytes) -> bytes:
    """A .npz whose compressed bytes were changed, its directory left as it was."""
    place = content.index(b"cube.npy") + 12
    return content[:place] + bytes(255 - byte for byte in content[place : place + 40]) + content[place + 40 :]


CUBES = {
    "huge.npy": header("{'descr': '<c8', 'fortran_order': False, 'shape': (1000000, 1000000, 48)}"),
    "endless.npy": header("{'descr': '<c8', 'fortran_order': False, 'shape': (9" + "9" * 4000 + ",)}"),
    "long.npy": header("{'descr'" + " " * 30000 + "}"),
    "nested.npy": header("(" * 9000),
    "tokens.npy": header("{'descr': '<c8', 'fortran_order': False, 'shape': (1L,"),
    "cut.npy": CUBE[:-7],
    "magic.npy": b"\x93NUMPY\x09\x00",
    "object.npy": of_array(np.array([{}], object)),
    "big.npy": of_array(np.full(SHAPE, 1e30, np.complex128)),
    "zlib.npz": scrambled(npz(cube=CUBE, radar=RADAR_TEXT)),
    "object.npz": npz(cube=of_array(np.array([{}], object)), radar=RADAR_TEXT),
    "nested.npz": npz(cube=CUBE, radar=of_array(np.asarray("[" * 100_000))),
    "numbers.npz": npz(cube=CUBE, radar=of_array(np.arange(3))),
    "radar.npz": npz(cube=CUBE, radar=of_array(np.asarray('{"grid": {"bins": 10000000}}'))),
    "cube.npz": npz(cube=CUBE, radar=of_array(np.asarray('{"waveform": {"chirps": 65536, "samples": 1048576}}'))),
    "tar.npz": b"not a zip file",
}  # fmt: skip
SAID = {
    "huge.npy": "not readable: Unable to allocate 349. TiB",
    "zlib.npz": "not readable: ",
    "radar.npz": "radar: grid.bins = 10000000; expected input should be less than or equal to 65536",
    "cube.npz": "radar: document: chirps = 65536 x samples = 1048576 x 48 channels make a cube of 2.64e+04 GB;",
    "big.npy": "cube has samples of 1e+30; expected at most 1e+12",
}
"""The beginning of what some must say, behind the file's name."""


@pytest.mark.parametrize("name", CUBES)
def test_a_hostile_cube_is_one_line(tmp_path, capsys, monkeypatch, name):
    (tmp_path / name).write_bytes(CUBES[name])
    (tmp_path / "radar.toml").write_text("[waveform]\nsamples = 32\nrange_bins = 24\nchirps = 4\n")
    run = make_run(tmp_path / "run", FULL, RADAR)
    more = ["--radar", tmp_path / "radar.toml"] if name.endswith(".npy") else []
    if name == "big.npy":
        (tmp_path / "radar.toml").write_text(
            "[waveform]\nsamples = 32\nrange_bins = 24\nchirps = 4\n[array]\n"
            f"tx_m = {json.dumps(RADAR.array.tx_m)}\nrx_m = {json.dumps(RADAR.array.rx_m)}\n"
        )
    code, line = status(capsys, monkeypatch, "predict", run, tmp_path / name, "--out", tmp_path / "out", *more)
    assert (code, line.count("\n")) == (2, 1), line
    assert line.startswith(f"trainer: {tmp_path / name}: {SAID.get(name, '')}"), line
    assert len(line) < 1000 or name == "endless.npy"
    assert not (tmp_path / "out").exists()


def test_a_run_that_is_nested_deeply_or_asks_for_much_is_one_line(tmp_path, capsys, monkeypatch, data):
    run = make_run(tmp_path / "run", FULL, RADAR)
    document = json.loads((run / "run.json").read_text())
    for text, message in (
        ("[" * 200_000, "not readable as JSON"),
        (json.dumps(sealed(document | {"config": document["config"] | {"width": 10**9}})), "config.width = 1000000000"),
    ):
        (run / "run.json").write_text(text)
        code, line = status(capsys, monkeypatch, "predict", run, data, "--out", tmp_path / "out")
        assert (code, line.count("\n")) == (2, 1), line
        assert line.startswith(f"trainer: {run}/run.json: {message}"), line


def test_a_manifest_that_is_nested_deeply_is_one_line(tmp_path, capsys, monkeypatch):
    (tmp_path / "manifest.json").write_text('{"a":' * 200_000)
    code, line = status(capsys, monkeypatch, "fit", tmp_path, "--out", tmp_path / "out")
    assert (code, line.count("\n")) == (2, 1)
    assert line.startswith(f"trainer: {tmp_path}/manifest.json: not readable as JSON")


def test_a_checkpoint_of_something_else_is_one_line_that_names_it(tmp_path, capsys, monkeypatch, data):
    run = tmp_path / "run"
    assert status(capsys, monkeypatch, "fit", data, "--out", run, *SIZE)[0] is None
    path = run / "last.ckpt"
    whole = path.read_bytes()
    content = torch.load(path, weights_only=True)
    pieces = {
        "cut short": whole[: len(whole) // 2], "empty": b"", "text": b"not a checkpoint", "a zip": npz(cube=CUBE),
        "a bit": whole[: len(whole) // 2] + bytes([whole[len(whole) // 2] ^ 1]) + whole[len(whole) // 2 + 1 :],
    }  # fmt: skip
    changed = {
        "a list": [1, 2], "without loops": {name: content[name] for name in content if name != "loops"},
        "of another network": content | {"state_dict": {"weight": torch.zeros(3)}},
        "of other loops": content | {"loops": {"fit_loop": 3}},
        "of other optimisers": content | {"optimizer_states": [{}]},
    }  # fmt: skip
    for name, value in changed.items():
        buffer = io.BytesIO()
        torch.save(value, buffer)
        pieces[name] = buffer.getvalue()
    for name, damaged in pieces.items():
        path.write_bytes(damaged)
        code, line = status(capsys, monkeypatch, "fit", data, "--out", run, *SIZE, "--resume")
        assert (code, line.count("\n")) == (2, 1), (name, line)
        assert line.startswith(f"trainer: {path}: "), (name, line)
    path.write_bytes(whole)
    assert status(capsys, monkeypatch, "fit", data, "--out", run, *SIZE, "--resume")[0] is None


@pytest.mark.slow
@pytest.mark.parametrize(("command", "largest"), [("evaluate", 30_000), ("fit", 60_000)])
def test_a_full_disk_names_the_file_and_nothing_partial_stays(tmp_path, command, largest):
    """A limit on the size of files stands for a disk that is full."""
    make, out = {"evaluate": make_data, "fit": small_dataset}[command], tmp_path / "run"
    data = make(tmp_path / "data")
    arguments = {
        "evaluate": ["--arrays", "full", "--methods", "das", "--experiments", "noise-only", "--trials", "2"],
        "fit": [*SIZE, "--hidden", "64", "--width", "8"],
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
