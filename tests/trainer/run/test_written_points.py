"""What ``trainer predict --points`` writes: the column, files for other tools, and lists of whole cubes."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from captured_cubes import noisy, write_plain_cube
from paper_arrays import RADAR
from tiny_radar import small_dataset
from tiny_run import make_run
from typer.testing import CliRunner

from shared.radar import load_radar
from shared.signal import if_signal
from trainer import predict
from trainer.cli.app import app
from trainer.data.simulation import amplitude_of, in_plane
from trainer.run.detection_files import UNITS, write_csv, write_pcd
from trainer.run.detections import Detections

SOME = Detections(
    np.array([10.0, 20.0]), np.array([0.6, -0.8]), np.array([1.5, 0.0]), np.array([-100.0, -120.5]),
    np.array([1e-4, 2e-3]), np.array([0.75, 0.5]), np.array([1e-3, 0.04]), np.array([0.05, 0.05]),
    np.array([0.25, math.nan]), np.array([70, 64]), np.array([30.0, 12.0]),
)  # fmt: skip


def test_csv_has_a_line_a_detection(tmp_path) -> None:
    write_csv(tmp_path / "d.csv", [(3, SOME), (4, SOME)])
    with (tmp_path / "d.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["frame_id"] for row in rows] == ["3", "3", "4", "4"]
    assert list(rows[0]) == ["frame_id", *UNITS]
    assert [float(rows[0][name]) for name in UNITS] == [10.0, 0.6, 1.5, -100.0, 1e-4, 0.75, 1e-3, 0.05, 0.25, 70, 30]
    assert rows[1]["moving"] == ""


def test_a_point_cloud_says_what_it_holds(tmp_path) -> None:
    write_pcd(tmp_path / "d.pcd", SOME)
    lines = (tmp_path / "d.pcd").read_text().splitlines()
    header = dict(line.split(" ", 1) for line in lines[:11])
    assert (header["VERSION"], header["FIELDS"]) == ("0.7", "x y z intensity velocity probability moving")
    assert (header["WIDTH"], header["HEIGHT"], header["POINTS"], header["DATA"]) == ("2", "1", "2", "ascii")
    for name in ("SIZE", "TYPE", "COUNT"):
        assert len(header[name].split()) == 7
    assert lines[11].split() == ["8", "6", "0", "-100", "1.5", "0.75", "0.25"]
    assert lines[12].split() == ["12", "-16", "0", "-120.5", "0", "0.5", "nan"]
    assert len(lines) == 13


def listed(source: Any, out: Path, **options: Any) -> list[dict[str, Any]]:
    """What predict lists of the only frame."""
    predict(source, out, pictures=False, points=True, **options)
    (found,) = pq.read_table(out / "images.parquet")["detections"].to_pylist()
    return found


@pytest.mark.parametrize(
    "changes",
    [{"detection": 0.0}, {}, {"model": "spectral-unet", "target": "class"}],
    ids=["of the image", "of a detection head", "of a network of probabilities"],
)
def test_predict_writes_the_list_beside_the_image(tmp_path, changes: dict[str, Any]) -> None:
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run", **changes)
    found = listed([run, data], tmp_path / "out", split="test")
    assert len(found) >= 6  # one or two targets in every third of 24 range bins, far above the noise
    assert list(found[0]) == list(UNITS)
    description = json.loads(pq.read_schema(tmp_path / "out/images.parquet").metadata[b"sparseradar"])
    assert description["points"] == {"cells": "peaks", "false_alarms": 1.0}
    assert [row["amplitude_db"] for row in found] == sorted((row["amplitude_db"] for row in found), reverse=True)
    assert all(0.0 < row["probability"] < 1.0 for row in found)
    assert description["units"]["detections"] == UNITS
    predict([run, data], tmp_path / "plain", split="test", pictures=False)
    assert pq.read_schema(tmp_path / "plain/images.parquet").names == ["frame_id", "image", "velocity"]


@pytest.mark.parametrize(("form", "files"), [("csv", ["detections.csv"]), ("pcd", ["frame-000200.pcd"])])
def test_other_tools_get_files_from_the_command_line(tmp_path, form: str, files: list[str]) -> None:
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run")
    command = ["predict", str(run), str(data), "--out", str(tmp_path / "out"), "--no-pictures"]
    result = CliRunner().invoke(app, [*command, "--points", "--points-format", form])
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.name != "images.parquet") == files


def test_all_cells_of_a_cube_list_what_the_three_peaks_leave_out(tmp_path) -> None:
    """Twelve targets in one range bin at 9 m, where wave fronts are curved, each at its own Doppler cell."""
    waveform = RADAR.waveform.model_copy(update={"chirps": 64})
    radar = RADAR.model_copy(update={"waveform": waveform})
    u, cells = np.linspace(-0.6, 0.6, 12), np.arange(4, 64, 5)
    place = in_plane(np.full(12, 60.0 * waveform.range_step_m), u)
    velocity = place / np.linalg.norm(place, axis=1, keepdims=True) * waveform.velocities_mps[cells][:, None]
    amplitude = np.full(12, amplitude_of(25.0, radar), complex)
    cube = noisy(if_signal(radar, place, velocity, amplitude), radar, np.random.default_rng(0))
    path = write_plain_cube(tmp_path / "cube.npz", cube, radar)
    seen = {}
    for which in ("peaks", "all"):
        found = listed(path, tmp_path / which, method="das", cells=which)
        seen[which] = [
            any(row["doppler_cell"] == cell and abs(row["u"] - angle) < 0.01 for row in found)
            for cell, angle in zip(cells, u, strict=True)
        ]
    assert sum(seen["peaks"]) <= 9  # three in each of the three range bins that see them
    assert all(seen["all"])
    assert len(found) <= 14


@pytest.mark.parametrize("speed", [8.0, 11.0, 14.0])
def test_an_echo_that_migrates_through_range_bins_is_one_line(tmp_path, speed: float) -> None:
    """At 14 m/s it does by one bin; that velocity is folded. The sum of eq. (1), six echoes 40 dB over the noise."""
    waveform = RADAR.waveform.model_copy(update={"samples": 256, "range_bins": 240})
    radar, draw = RADAR.model_copy(update={"waveform": waveform}), np.random.default_rng(int(speed))
    bins, u = np.arange(50.0, 230.0, 30.0) + draw.uniform(-0.5, 0.5, 6), draw.uniform(-0.6, 0.6, 6)
    place = in_plane(bins * waveform.range_step_m, u)
    rate = speed * draw.choice([-1.0, 1.0], 6) + draw.uniform(-0.5, 0.5, 6) * waveform.velocity_step_mps
    velocity = place / np.linalg.norm(place, axis=1, keepdims=True) * rate[:, None]
    start = place - 0.5 * waveform.chirps * waveform.chirp_interval_s * velocity
    echo = if_signal(radar, start, velocity, np.full(6, amplitude_of(40.0, radar), complex))
    path = write_plain_cube(tmp_path / "cube.npz", noisy(echo, radar, draw), radar)
    for which in ("peaks", "all"):
        found = listed(path, tmp_path / which, method="das", cells=which)
        strong = sorted((row for row in found if row["snr_db"] > 20.0), key=lambda row: row["range"])
        np.testing.assert_allclose([row["range"] for row in strong], bins * waveform.range_step_m, atol=0.02)
        np.testing.assert_allclose([row["u"] for row in strong], u, atol=2e-3)


@pytest.mark.parametrize("speed", [8.4, 13.9])
def test_an_echo_that_migrates_is_one_line_where_coinciding_elements_tell_its_interval(tmp_path, speed: float) -> None:
    """Its Doppler cell counts the intervals: taken for a folded one it would migrate by less than nothing."""
    radar = load_radar("mmwcas-azimuth")
    short = {name: getattr(radar.waveform, name) / 4.0 for name in ("chirp_duration_s", "bandwidth_hz")}
    waveform = radar.waveform.model_copy(update={"samples": 64, "range_bins": 64, **short})
    radar = radar.model_copy(update={"waveform": waveform})
    start = np.array([[15.2 * np.sqrt(1.0 - 0.2**2), 15.2 * 0.2, 0.0]])
    velocity = speed * start / np.linalg.norm(start)
    echo = if_signal(radar, start, velocity, np.full(1, amplitude_of(30.0, radar), complex))
    path = write_plain_cube(tmp_path / "cube.npz", noisy(echo, radar, np.random.default_rng(1)), radar)
    found = listed(path, tmp_path / "out", method="das", cells="all")
    strong = [row for row in found if row["snr_db"] > 30.0]
    assert len(strong) == 1
    assert strong[0]["velocity"] == pytest.approx(speed, abs=0.005)  # each of two was off by 0.03
