"""The command line: exit status and one line, and the commands one after the other."""

import subprocess
import sys

import pytest
from command_line import ended
from tiny_radar import frame, small_dataset, write_dataset
from tiny_run import make_run
from typer.testing import CliRunner

from trainer.cli import app as cli
from trainer.cli.app import app
from trainer.errors import Stopped
from trainer.run.folder import read_run

SIZE = ["--width", "4", "--rows", "16", "--steps", "4", "--validate-every", "4", "--array", "full"]


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (Stopped("loss is not finite"), 1, "trainer: loss is not finite\n"),
        (OSError(28, "No space left on device", "run/last"), 1, "trainer: run/last: No space left on device\n"),
        (KeyboardInterrupt(), 130, "trainer: interrupted; the same command with --resume goes on"),
    ],
)  # fmt: skip
def test_a_run_that_failed_is_one_line_and_status_1(monkeypatch, error, code, line):
    def failing(**_):
        raise error

    monkeypatch.setattr(cli, "app", failing)
    found, _, text = ended("trainer")
    assert found == code
    assert text.startswith(line)
    assert text.count("\n") == 1


@pytest.mark.parametrize(
    ("work", "arguments", "advice"),
    [
        ("trainer.evaluation.evaluate.evaluate", ["evaluate", "data"],
         "the same command with --resume goes on from the last checkpoint"),
        ("trainer.run.predict.predict", ["predict", "x.npy", "--method", "das"],
         "it has no --resume: run it again, into a new or emptied --out"),
        ("trainer.captures.importing.import_capture", ["import", "x.bin", "--board", "iwr1843"],
         "it has no --resume: run it again"),
    ],
)  # fmt: skip
def test_an_interrupted_command_says_how_to_go_on(monkeypatch, work, arguments, advice):
    """As typer hands it on, which swallows Ctrl-C of its own accord."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(work, interrupted)
    code, _, text = ended("trainer", *arguments, "--out", "out.npz")
    assert (code, text) == (130, f"trainer: interrupted; {advice}\n")


def test_names_are_printed_as_they_are(monkeypatch, tmp_path):
    """Rich would make a picture of :car:, and take [0] for markup. The dataset has no frames to test."""
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "a:smile:b", {"train": [frame(0)], "validation": [frame(1)]})
    monkeypatch.setattr("trainer.training.fit.fit", lambda out, announce, **_: announce(f"weights in {out}"))
    code, said, _ = ended("trainer", "fit", "a:smile:b", "--out", "out/:car:/[0]")
    assert code == 0
    assert said.startswith("weights in out/:car:/[0]\nrun in out/:car:/[0]; curves: ")
    assert "trainer predict 'out/:car:/[0]' a:smile:b --split all --out DIR" in said


def test_what_an_interrupted_predict_advises_works(tmp_path, monkeypatch):
    """The folder has a picture and no images.parquet, and is refused until it is emptied."""
    data, out = small_dataset(tmp_path / "data"), tmp_path / "images"

    def interrupted(path, *_):
        path.write_bytes(b"")
        raise KeyboardInterrupt

    arguments = ("predict", data, "--method", "das", "--out", out)
    with monkeypatch.context() as patched:
        patched.setattr("trainer.run.pictures.save_picture", interrupted)
        assert ended("trainer", *arguments)[0] == 130
    (picture,) = out.iterdir()
    assert "is not empty; expected an empty or new folder" in ended("trainer", *arguments)[2]
    picture.unlink()
    assert ended("trainer", *arguments)[0] == 0
    assert (out / "images.parquet").is_file()


def test_a_fit_from_none_is_one_that_does_not_say(tmp_path, monkeypatch):
    """Also where a run folder has that name: ./none is it."""
    monkeypatch.chdir(tmp_path)
    data = small_dataset(tmp_path / "data")
    notes = []
    for out, begin in (("none", ()), ("second", ("--from", "none")), ("third", ("--from", "./none"))):
        arguments = ("fit", data, "--out", out, "--model", "spectral-unet", "--hidden", "16", *SIZE, *begin)
        assert ended("trainer", *arguments)[0] == 0
        notes.append((tmp_path / out / "run.json").read_bytes())
    assert notes[0] == notes[1]
    assert read_run(tmp_path / "second").start is None
    start = read_run(tmp_path / "third").start
    assert start is not None
    assert start.name == "none"


def test_fit_predict_and_export_work_one_after_the_other(tmp_path):
    data, run = small_dataset(tmp_path / "data"), tmp_path / "run"
    runner = CliRunner()
    for arguments in (
        ["fit", data, "--out", run, "--model", "spectral-unet", "--hidden", "16", *SIZE],
        ["predict", run, data, "--out", tmp_path / "images"],
        ["export", run, "--out", tmp_path / "network.onnx"],
    ):
        result = runner.invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
        assert result.exit_code == 0, result.output
    assert "of torch; one image takes" in result.output
    assert (tmp_path / "images/images.parquet").is_file()
    assert (tmp_path / "images/frame-000200.png").is_file()


def test_predict_imports_no_pandas(tmp_path):
    """Where it is installed ``pa.array`` and ``to_numpy`` of Arrow take a tenth of a second for it."""
    data, run = small_dataset(tmp_path / "data"), make_run(tmp_path / "run")
    arguments = ["predict", run, data, "--points", "--points-format", "csv", "--out", tmp_path / "images"]
    command = [sys.executable, "-X", "importtime", "-m", "trainer", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert {"pyarrow", "torch", "matplotlib"} < imported
    assert "pandas" not in imported
    assert (tmp_path / "images" / "detections.csv").is_file()
