"""``trainer import`` and ``calibrate``: from the samples of a board to an image, and what they refuse."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import ended, refused
from oracles import reference_file
from raw_files import radar_of, scene, write_two_lanes

from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal.imaging import steering_matrix
from shared.signal.signal import if_signal
from shared.signal.tdm import statement
from trainer import import_capture, predict
from trainer.captures.cube_file import read_cube
from trainer.data.measurements import open_measurements


def test_from_samples_to_an_image(tmp_path: Path) -> None:
    """The echo that stands is found where it was put, on the right (0.26 left of 0, i.e. u = -0.256), after TDM."""
    radar = radar_of(tmp_path, "iwr1843", "tx = [1, 3]\n")
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 2), radar)
    common = ("--board", "iwr1843", "--radar", tmp_path / "capture.toml")
    code, said, _ = ended("trainer", "import", tmp_path / "adc.bin", *common, "--out", tmp_path / "cube.npz")
    assert (code, said.splitlines()[0]) == (
        0, f"2 frames of 4 chirps x 32 samples x 8 channels (2 TX, 4 RX) in {tmp_path / 'cube.npz'}",
    )  # fmt: skip
    found, measurements = open_measurements(tmp_path / "cube.npz", None, "test")
    first = next(iter(measurements))
    row = round(float(np.hypot(3.4, 0.9)) / found.waveform.range_step_m)
    image = np.abs(steering_matrix(found, found.array).T @ first.cells.range_channel[0, row])
    assert found.grid.u[image.argmax()] == pytest.approx(-0.9 / np.hypot(3.4, 0.9), abs=0.06)


def test_an_empty_first_frame_is_told_and_has_no_points(tmp_path: Path) -> None:
    """With a noise of 0 650 lines a frame were listed."""
    radar = radar_of(tmp_path, "iwr1642")
    cube = 1000.0 * scene(radar, 3, noise=0.03)
    cube[0] = 0.0
    np.save(tmp_path / "a.npy", cube)
    common = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--axes", "frame chirp sample (rx tx)")
    code, said, _ = ended("trainer", "import", tmp_path / "a.npy", *common, "--out", tmp_path / "cube.npz")
    assert code == 0
    assert "empty frames first: 1; noise and dead channels are those of frame 1" in said
    predict([tmp_path / "cube.npz"], tmp_path / "out", method="das", points=True, pictures=False)
    listed = [len(lines) for lines in pq.read_table(tmp_path / "out/images.parquet")["detections"]]
    assert listed[0] == 0
    assert 2 <= min(listed[1:]) <= max(listed) <= 12


@pytest.mark.parametrize(("chirps", "told"), [(1, None), (2, None), (3, "velocities to ")])
def test_velocities_are_told_as_far_as_they_go(tmp_path: Path, chirps: int, told: str | None) -> None:
    """Of two chirps there are none; of three the axis ends at half its span, where the line on TDM has it too."""
    radar_of(tmp_path, "iwr1843", "tx = [1, 3]\n")
    text = (tmp_path / "capture.toml").read_text(encoding="utf-8").replace("chirps = 4", f"chirps = {chirps}")
    (tmp_path / "capture.toml").write_text(text, encoding="utf-8")
    radar = load_radar(tmp_path / "capture.toml")
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar)
    common = ("--board", "iwr1843", "--radar", tmp_path / "capture.toml")
    code, said, _ = ended("trainer", "import", tmp_path / "adc.bin", *common, "--out", tmp_path / "cube.npz")
    assert code == 0
    line = str(statement(radar))
    if told is None:
        assert "velocities to" not in said
        assert line == "TDM of 2 TX: frames of fewer than three chirps tell no velocity; what moves has a wrong angle"
    else:
        half = radar.waveform.velocity_span_mps / 2.0
        assert f"velocities to {half:.2f} m/s" in said
        assert f"from {-half:.3g} to {half:.3g} m/s" in line


@pytest.mark.parametrize(("frames", "count"), [("1:", 2), (":2", 2), ("1:2", 1), ("0:5", 3)])
def test_frames_are_chosen_by_their_begin_and_end(tmp_path: Path, frames: str, count: int) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 3), radar)
    common = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--out", tmp_path / "cube.npz")
    code, said, _ = ended("trainer", "import", tmp_path / "adc.bin", *common, "--frames", frames)
    assert code == 0
    assert f"{count} frames of 4 chirps" in said
    assert (f"frames 0 to 2 of {tmp_path / 'adc.bin'}, which has no more" in said) == (frames == "0:5")


@pytest.mark.parametrize("frames", ["1", ":", "1:3", (0, 2.5), (0,), (None, 2), (0, 1, 2), 3])
def test_frames_that_are_none_are_one_line_in_python_too(tmp_path: Path, frames: Any) -> None:
    """They were errors of Python's own. A path of a radar file is taken as its text is."""
    radar = radar_of(tmp_path, "iwr1642")
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar)
    given: dict[str, Any] = {"capture": tmp_path / "adc.bin", "radar": tmp_path / "capture.toml"}
    with pytest.raises(InputError, match=r"--frames: .*; expected a pair of whole numbers, e.g. \(0, 10\)"):
        import_capture("iwr1642", **given, out=tmp_path / "cube.npz", frames=frames)
    assert import_capture("iwr1642", **given, out=tmp_path / "cube.npz", frames=(0, None)).frames == 1
    if isinstance(frames, str) and frames != "1:3":
        common = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--out", tmp_path / "b.npz")
        code, _, said = ended("trainer", "import", tmp_path / "adc.bin", *common, f"--frames={frames}")
        assert (code, said) == (2, f"trainer: --frames: {frames!r}; expected BEGIN:END, e.g. 0:10\n")


def test_noise_of_0_beside_samples_is_refused(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    cube = scene(radar)
    cube[..., :5] = 0.0
    np.save(tmp_path / "a.npy", cube[0])
    common = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--axes", "chirp sample (rx tx)")
    said = refused("trainer", "import", tmp_path / "a.npy", *common, "--out", tmp_path / "cube.npz")
    assert said.startswith(f"trainer: {tmp_path / 'a.npy'}: noise of 0 beside samples that are not 0; expected noise")
    assert not (tmp_path / "cube.npz").exists()


def test_calibrate_then_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    code, said, _ = ended("trainer", "calibrate", "corner.bin", *common, *stands, *check, "--out", "calibration.toml")
    assert code == 0
    assert said.startswith("8 channels in calibration.toml: gain 1.")
    arguments = ("--calibration", "calibration.toml", "--out", "cube.npz")
    code, said, _ = ended("trainer", "import", "other.bin", *common, *arguments)
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


def test_a_public_capture_has_its_echoes_where_they_are_stated_to_be(tmp_path: Path) -> None:
    """OpenRadar's indoor capture: ranges to 0.1 m, velocities to half a Doppler cell, angles to 1 deg, uncalibrated."""
    source = reference_file("measured", "openradar", "doppler_example_1.npy")
    (tmp_path / "capture.toml").write_text(OPENRADAR, encoding="utf-8")
    options = ("--board", "iwr1642", "--radar", tmp_path / "capture.toml", "--out", tmp_path / "cube.npz")
    code, said, _ = ended("trainer", "import", source, *options)
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
            for peak in np.flatnonzero(np.abs(frame.cells.velocity[:, row] - velocity) < 0.042):
                image = np.abs(steering.T @ frame.cells.range_channel[peak, row])
                best = max(best, (float(image.max()), float(np.rad2deg(np.arcsin(found.grid.u[image.argmax()])))))
        assert best[1] == pytest.approx(angle_deg, abs=1.0)
