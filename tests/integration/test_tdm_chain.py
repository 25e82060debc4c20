"""TX in turns through both packages: what simulation stores is what the import of its cube makes of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from datafactory.cli.app import app
from shared.dataset.folder import open_dataset
from shared.radar import load_radar
from shared.signal.imaging import delay_and_sum
from trainer.data.measurements import open_measurements

OVERLAPPED = """
[waveform]
chirps = 32
samples = 64
range_bins = 64
bandwidth_hz = 500e6
chirp_duration_s = 40e-6
chirp_interval_s = 120e-6
multiplexing = "tdm"
[array]
tx_m = [[0.0, 0.0, 0.0], [0.0, 5.82e-3, 0.0], [0.0, 11.64e-3, 0.0]]
rx_m = [[0.0, -2.91e-3, 0.0], [0.0, -0.97e-3, 0.0], [0.0, 0.97e-3, 0.0], [0.0, 2.91e-3, 0.0]]
[grid]
bins = 60
"""


def test_simulation_and_import_see_the_same_channels_velocities_and_angles(tmp_path):
    (tmp_path / "boards.toml").write_text(OVERLAPPED, encoding="utf-8")
    radar = load_radar(str(tmp_path / "boards.toml"))
    span = radar.waveform.velocity_span_mps  # 16 m/s
    # Receding, at the left; approaching faster than half of the Doppler axis, at the right.
    targets = [{"x": 8.0, "y": 4.0, "vx": 3.0, "rcs_dbsm": 10}, {"x": 12.0, "y": -6.0, "vx": -14.0, "rcs_dbsm": 20}]
    (tmp_path / "targets.json").write_text(json.dumps([targets]), encoding="utf-8")
    arguments = ["points", "--targets", "targets.json", "--radar", "boards.toml", "--store", "cube", "--out", "data"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        made = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "resolve 3 Doppler intervals" in made.output
    dataset = open_dataset(tmp_path / "data")
    assert "resolve 3 Doppler intervals" in dataset.description()["conventions"]["velocity"]
    (frame,) = dataset.frames("train")
    assert frame.cube is not None
    np.savez(tmp_path / "cube.npz", cube=frame.cube, radar=radar.model_dump_json())
    _, (measurement,) = open_measurements(tmp_path / "cube.npz", None, "all")
    np.testing.assert_array_equal(measurement.range_channel, frame.range_channel)
    np.testing.assert_array_equal(measurement.velocity, frame.velocity)
    for target in frame.targets:
        row = round(target.range_m / radar.waveform.range_step_m)
        assert frame.velocity[0, row] == pytest.approx(target.velocity_mps, abs=0.51 * radar.waveform.velocity_step_mps)
        image = np.abs(delay_and_sum(frame.range_channel[0, row], radar))
        assert radar.grid.u[image.argmax()] == pytest.approx(target.u, abs=0.04)
        # The truth of one TX needs none of this, and has it at the same place.
        assert radar.grid.u[frame.image[row].argmax()] == pytest.approx(target.u, abs=0.04)
    assert min(target.velocity_mps for target in frame.targets) < -0.5 * span
