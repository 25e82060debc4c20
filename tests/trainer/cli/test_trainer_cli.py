"""The command line: exit status and one line; several processes train what one trains."""

import os
import subprocess
import sys

import pytest
import torch
from small_dataset import make_traced
from small_evaluation import FULL, make_run
from tiny_radar import RADAR, small_dataset
from typer.testing import CliRunner

from trainer.cli import app as cli
from trainer.cli.app import app, main
from trainer.errors import TrainingStopped

SIZE = ["--width", "4", "--hidden", "16", "--rows", "16", "--steps", "4", "--validate-every", "4", "--array", "full"]


def status(capsys, monkeypatch, *arguments):
    """(exit status, standard error) of the command."""
    monkeypatch.setattr(sys, "argv", ["trainer", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fit", "none", "--out", "run"), "trainer: none/manifest.json: no such file; expected the folder"),
        (("fit", "none", "--out", "run", "--model", "u-net"), "trainer: trainer fit: model = 'u-net'; expected input"),
        (("fit", "none", "--out", "run", "--steps", "0"), "trainer: trainer fit: steps = 0; expected input should"),
        (
            ("fit", "none", "--out", "run", "--target", "paper"),
            "trainer: trainer fit: document: model 'unrolled' answers",
        ),
        (
            ("fit", "none", "--out", "run", "--model", "spectral-unet", "--target", "paper"),
            "trainer: trainer fit: document: target 'paper' is normalised per whole image",
        ),
        (("fit", "none", "--out", "run", "--recipe", "best"), "trainer: --recipe: 'best'; expected recommended"),
        (("fit", "ftp://host/set", "--out", "run"), "trainer: ftp://host/set: scheme 'ftp'; expected a local path, or"),
        (("fit", "s3://", "--out", "run"), "trainer: s3://: names no bucket; expected s3://BUCKET"),
        (("predict", "none", "none", "--out", "o"), "trainer: none: no run.json; expected a run folder"),
        (("export", "none", "--out", "o.onnx"), "trainer: none: no run.json; expected a run folder"),
        (("evaluate", "none", "--out", "o", "--bogus"), "trainer: No such option: --bogus"),
        (("evaluate", "none"), "trainer: Missing option '--out'"),
        (("judge", "none"), "trainer: No such command 'judge'"),
    ],
)
def test_a_user_s_error_is_one_line_and_status_2(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, line = status(capsys, monkeypatch, *arguments)
    assert code == 2
    assert line.startswith(message)
    assert line.count("\n") == 1


@pytest.mark.parametrize(
    "command",
    [
        ("fit", "TRACED", "--array", "full"),
        ("evaluate", "TRACED", "--arrays", "full", "--methods", "das"),
        ("predict", "RUN", "TRACED"),
        ("predict", "RUN", "TRACED", "--split", "all"),
    ],
)
def test_a_folder_of_traced_paths_is_refused_in_one_line(tmp_path, capsys, monkeypatch, command):
    traced = make_traced(tmp_path / "traced")
    places = {"TRACED": traced, "RUN": make_run(tmp_path / "run", FULL, RADAR)}
    arguments = [places.get(word, word) for word in command]
    code, line = status(capsys, monkeypatch, *arguments, "--out", tmp_path / "out")
    assert code == 2
    made_by = f"datafactory render --paths {traced} --out OTHER"
    expected = f"holds traced paths and no frames; expected a dataset, as made by {made_by}"
    assert line == f"trainer: {traced}: {expected}\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (TrainingStopped("loss is not finite"), 1, "trainer: loss is not finite\n"),
        (OSError(28, "No space left on device", "run/last"), 1, "trainer: run/last: No space left on device\n"),
        (KeyboardInterrupt(), 130, "trainer: interrupted; the same command with --resume goes on"),
    ],
)  # fmt: skip
def test_a_run_that_failed_is_one_line_and_status_1(capsys, monkeypatch, error, code, line):
    def failing(**_):
        raise error

    monkeypatch.setattr(cli, "app", failing)
    found, text = status(capsys, monkeypatch)
    assert found == code
    assert text.startswith(line)
    assert text.count("\n") == 1


def test_an_interrupted_command_says_how_to_go_on(capsys, monkeypatch):
    """As typer hands it on, which swallows Ctrl-C of its own accord."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("trainer.evaluation.evaluate.evaluate", interrupted)
    code, text = status(capsys, monkeypatch, "evaluate", "data", "--out", "out")
    assert code == 130
    assert text.startswith("trainer: interrupted; the same command with --resume goes on")


def test_fit_predict_and_export_work_one_after_the_other(tmp_path):
    data, run = small_dataset(tmp_path / "data"), tmp_path / "run"
    runner = CliRunner()
    for arguments in (
        ["fit", data, "--out", run, "--model", "spectral-unet", *SIZE],
        ["predict", run, data, "--out", tmp_path / "images"],
        ["export", run, "--out", tmp_path / "network.onnx"],
    ):
        result = runner.invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
        assert result.exit_code == 0, result.output
    assert "of torch; one image takes" in result.output
    assert (tmp_path / "images/images.parquet").is_file()
    assert (tmp_path / "images/frame-000200.png").is_file()


@pytest.mark.slow
def test_two_processes_train_what_one_trains(tmp_path):
    """Two processes with a batch of 2 each against one with a batch of 4: equal but for the order of sums.

    Held to the relative norm over all weights, because Adam turns the rounding of a gradient near zero into a step
    of that one weight. Measured: 3.5e-5; one process with a batch of 2, i.e. half of the data, differs by 1.6e-2.
    """
    data = small_dataset(tmp_path / "data")

    def fit(name, devices, batch):
        command = ["fit", data, "--out", tmp_path / name, *SIZE, "--devices", devices, "--batch", batch]
        return [str(part) for part in command]

    alone = CliRunner().invoke(app, fit("one", 1, 4), catch_exceptions=False)
    assert alone.exit_code == 0, alone.output
    done = subprocess.run(
        [sys.executable, "-m", "trainer", *fit("two", 2, 2)], env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    # The best weights may be the first; the last have seen all steps.
    one, two = (torch.load(tmp_path / name / "last.ckpt", weights_only=True)["state_dict"] for name in ("one", "two"))
    difference = torch.cat([(two[name] - one[name]).flatten() for name in one])
    assert difference.norm() <= 1e-3 * torch.cat([weight.flatten() for weight in one.values()]).norm()
    assert (tmp_path / "one/metrics.csv").read_text().count("\n") == 3
    assert (tmp_path / "two/metrics.csv").read_text().count("\n") == 3
