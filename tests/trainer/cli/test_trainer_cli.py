"""The command line: exit status and one line; several processes; a board's samples imported, calibrated, imaged."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import status
from oracles import reference_file
from raw_files import radar_of, scene, write_two_lanes
from tiny_radar import small_dataset
from tiny_run import make_run
from typer.testing import CliRunner

from shared.signal.imaging import steering_matrix
from shared.signal.signal import if_signal
from trainer.captures.cube_file import read_cube
from trainer.cli import app as cli
from trainer.cli.app import app
from trainer.data.measurements import open_measurements
from trainer.errors import TrainingStopped
from trainer.run.folder import read_run

SIZE = ["--width", "4", "--hidden", "16", "--rows", "16", "--steps", "4", "--validate-every", "4", "--array", "full"]


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
    found, _, text = status(capsys, monkeypatch)
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
def test_an_interrupted_command_says_how_to_go_on(capsys, monkeypatch, work, arguments, advice):
    """As typer hands it on, which swallows Ctrl-C of its own accord."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(work, interrupted)
    code, _, text = status(capsys, monkeypatch, *arguments, "--out", "out.npz")
    assert (code, text) == (130, f"trainer: interrupted; {advice}\n")


def test_what_an_interrupted_predict_advises_works(tmp_path, capsys, monkeypatch):
    """The folder has a picture and no images.parquet, and is refused until it is emptied."""
    data, out = small_dataset(tmp_path / "data"), tmp_path / "images"

    def interrupted(path, *_):
        path.write_bytes(b"")
        raise KeyboardInterrupt

    arguments = ("predict", data, "--method", "das", "--out", out)
    with monkeypatch.context() as patched:
        patched.setattr("trainer.run.pictures.save_picture", interrupted)
        assert status(capsys, patched, *arguments)[0] == 130
    (picture,) = out.iterdir()
    assert "is not empty; expected an empty or new folder" in status(capsys, monkeypatch, *arguments)[2]
    picture.unlink()
    assert status(capsys, monkeypatch, *arguments)[0] == 0
    assert (out / "images.parquet").is_file()


def test_a_fit_from_none_is_one_that_does_not_say(tmp_path, capsys, monkeypatch):
    """Also where a run folder has that name: ./none is it."""
    monkeypatch.chdir(tmp_path)
    data = small_dataset(tmp_path / "data")
    notes = []
    for out, begin in (("none", ()), ("second", ("--from", "none")), ("third", ("--from", "./none"))):
        arguments = ("fit", data, "--out", out, "--model", "spectral-unet", *SIZE, *begin)
        assert status(capsys, monkeypatch, *arguments)[0] == 0
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
        ["fit", data, "--out", run, "--model", "spectral-unet", *SIZE],
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


def test_from_samples_to_an_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The echo that stands is found where it was put, on the right (0.26 left of 0, i.e. u = -0.256), after TDM."""
    radar = radar_of(tmp_path, "iwr1843", "tx = [1, 3]\n")
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 2), radar)
    common = ("--board", "iwr1843", "--radar", tmp_path / "capture.toml")
    code, said, _ = status(capsys, monkeypatch, "import", tmp_path / "adc.bin", *common, "--out", tmp_path / "cube.npz")
    assert (code, said.splitlines()[0]) == (
        0, f"2 frames of 4 chirps x 32 samples x 8 channels (2 TX, 4 RX) in {tmp_path / 'cube.npz'}",
    )  # fmt: skip
    found, measurements = open_measurements(tmp_path / "cube.npz", None, "test")
    first = next(iter(measurements))
    row = round(float(np.hypot(3.4, 0.9)) / found.waveform.range_step_m)
    image = np.abs(steering_matrix(found, found.array).T @ first.range_channel[0, row])
    assert found.grid.u[image.argmax()] == pytest.approx(-0.9 / np.hypot(3.4, 0.9), abs=0.06)


def test_calibrate_then_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 16-bit samples: what is left of another reflector is quantisation, and the cube has the model error."""
    monkeypatch.chdir(tmp_path)
    radar = radar_of(tmp_path, "iwr1642")
    generator = np.random.default_rng(5)
    errors = 10.0 ** (generator.normal(0.0, 1.5, 8) / 20.0) * np.exp(1j * np.deg2rad(generator.normal(0.0, 12.0, 8)))
    for name, place in (("corner.bin", [[2.5, 0.0, 0.0]]), ("other.bin", [[2.7, -0.8, 0.0]])):
        cube = if_signal(radar, np.array(place), np.zeros((1, 3)), np.ones(1))
        write_two_lanes(tmp_path / name, np.asarray(cube * errors, dtype=np.complex128)[None], radar)
    common = ("--board", "iwr1642", "--radar", "capture.toml")
    angle = np.rad2deg(np.arctan2(-0.8, 2.7))
    check = ("--check", "other.bin", "--check-range", np.hypot(2.7, 0.8), "--check-angle", angle)
    stands = ("--range", 2.5, "--angle", 0.0)
    code, said, _ = status(
        capsys, monkeypatch, "calibrate", "corner.bin", *common, *stands, *check, "--out", "calibration.toml"
    )
    assert code == 0
    assert said.startswith("8 channels in calibration.toml: gain 1.")
    arguments = ("--calibration", "calibration.toml", "--out", "cube.npz")
    code, said, _ = status(capsys, monkeypatch, "import", "other.bin", *common, *arguments)
    assert code == 0
    capture = read_cube(tmp_path / "cube.npz", None).capture
    assert capture is not None
    assert capture.model_error_db is not None
    assert capture.model_error_db < -55.0
    assert f"calibrated; it leaves {capture.model_error_db:.1f} dB of a reflector" in said


OPENRADAR = """
[capture]
start_frequency_hz = 77.4201e9
slope_hz_per_s = 60e12
idle_time_s = 30e-6
ramp_end_time_s = 62e-6
samples = 128
sample_rate_hz = 2.5e6
chirps = 128
"""


def test_a_public_capture_has_its_echoes_where_they_are_stated_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenRadar's indoor capture: ranges to 0.1 m, velocities to half a Doppler cell, angles to 1 deg, uncalibrated."""
    source = reference_file("measured", "openradar", "doppler_example_1.npy")
    (tmp_path / "capture.toml").write_text(OPENRADAR, encoding="utf-8")
    options = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--out", tmp_path / "cube.npz")
    code, said, _ = status(capsys, monkeypatch, "import", source, *options)
    assert code == 0
    assert "axes of" in said
    assert "chirp (tx rx) sample" in said
    capture = read_cube(tmp_path / "cube.npz", None).capture
    assert capture is not None
    assert (capture.scale, capture.dead_channels) == ("relative", ())
    found, measurements = open_measurements(tmp_path / "cube.npz", None, "test")
    (frame,) = measurements
    steering = steering_matrix(found, found.array)
    for range_m, velocity, angle_deg in ((5.22, 0.0, 2.5), (2.95, 0.56, 7.0), (2.95, -0.48, -15.0)):
        best: tuple[float, float] = (0.0, np.nan)
        for row in np.flatnonzero(np.abs(found.waveform.ranges_m - range_m) < 0.1):
            for peak in np.flatnonzero(np.abs(frame.velocity[:, row] - velocity) < 0.042):
                image = np.abs(steering.T @ frame.range_channel[peak, row])
                best = max(best, (float(image.max()), float(np.rad2deg(np.arcsin(found.grid.u[image.argmax()])))))
        assert best[1] == pytest.approx(angle_deg, abs=1.0)
