"""Boards: what is simulated of one is what its capture would hold, and what the import of its cube makes of it."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from factory_command import run

from shared.dataset.folder import Dataset, open_dataset
from shared.radar import Radar, load_radar
from shared.signal.imaging import delay_and_sum
from shared.signal.signal import if_signal, target_amplitudes
from trainer.data.measurements import open_measurements

TWIN = """
board = "iwr1843"
[capture]
start_frequency_hz = 77e9
slope_hz_per_s = 30e12
idle_time_s = 7e-6
adc_start_time_s = 5e-6
ramp_end_time_s = 40e-6
samples = 64
sample_rate_hz = 2e6
chirps = 8
tx = [3, 1, 2]
[grid]
bins = 60
"""


def simulated(folder: Path, board: str, targets: list[dict[str, float]], *more: str) -> tuple[Radar, Dataset, str]:
    """A radar, a dataset of one frame of these targets with its cube, and what was said."""
    (folder / "board.toml").write_text(board, encoding="utf-8")
    (folder / "targets.json").write_text(json.dumps([targets]), encoding="utf-8")
    files = ("--targets", folder / "targets.json", "--radar", folder / "board.toml", "--out", folder / "data")
    said = run("points", *files, "--store", "cube", *more)
    return load_radar(str(folder / "board.toml")), open_dataset(folder / "data"), said


def test_the_twin_of_a_capture_has_its_chirps_and_order_of_tx(tmp_path: Path) -> None:
    """The exact sum of eq. (1) and (2) over the board's elements, TX3 first; and the target on its side."""
    target = {"x": 4.0, "y": 1.5, "z": 0.1, "vx": 2.0, "rcs_dbsm": 10.0, "phase": 0.4}
    radar, dataset, _ = simulated(tmp_path, TWIN, [target], "--no-noise")
    (frame,) = dataset.frames("train")
    assert frame.cube is not None
    position, velocity = np.array([[4.0, 1.5, 0.1]]), np.array([[2.0, 0.0, 0.0]])
    amplitude = target_amplitudes(radar, position, np.array([10.0]), np.array([0.4]))
    expected = if_signal(radar, position, velocity, amplitude)
    np.testing.assert_allclose(frame.cube, expected, atol=1e-5 * np.abs(amplitude[0]))
    row = round(float(np.linalg.norm(position)) / radar.waveform.range_step_m)
    image = np.abs(delay_and_sum(frame.range_channel[0, row], radar, radar.array.azimuth_channels))
    assert radar.grid.u[image.argmax()] == pytest.approx(1.5 / np.linalg.norm(position), abs=0.04)


def test_the_picture_of_the_boards_is_drawn(tmp_path: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "boards.py"))
    figure = example["draw"]()
    figure.savefig(tmp_path / "boards.png", dpi=20)
    assert len(figure.axes) == 9
    # Of every board the image peaks where the dashed line stands, on the left, which is drawn on the left.
    for axis in figure.axes[6:]:
        curve, dashed = axis.get_lines()
        assert curve.get_xdata()[curve.get_ydata().argmax()] == pytest.approx(dashed.get_xdata()[0], abs=0.01)
        assert axis.get_xlim()[0] > axis.get_xlim()[1]


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
    # Receding, at the left; approaching faster than half of the Doppler axis, at the right.
    targets = [{"x": 8.0, "y": 4.0, "vx": 3.0, "rcs_dbsm": 10}, {"x": 12.0, "y": -6.0, "vx": -14.0, "rcs_dbsm": 20}]
    radar, dataset, said = simulated(tmp_path, OVERLAPPED, targets)
    assert "resolve 3 Doppler intervals" in said
    assert "resolve 3 Doppler intervals" in dataset.description()["conventions"]["velocity"]
    (frame,) = dataset.frames("train")
    assert frame.cube is not None
    np.savez(tmp_path / "cube.npz", cube=frame.cube, radar=radar.model_dump_json())
    _, (measurement,) = open_measurements(tmp_path / "cube.npz", None, "all")
    np.testing.assert_array_equal(measurement.cells.range_channel, frame.range_channel)
    np.testing.assert_array_equal(measurement.cells.velocity, frame.velocity)
    for target in frame.targets:
        row = round(target.range_m / radar.waveform.range_step_m)
        assert frame.velocity[0, row] == pytest.approx(target.velocity_mps, abs=0.51 * radar.waveform.velocity_step_mps)
        image = np.abs(delay_and_sum(frame.range_channel[0, row], radar))
        assert radar.grid.u[image.argmax()] == pytest.approx(target.u, abs=0.04)
        # The truth of one TX needs none of this, and has it at the same place.
        assert radar.grid.u[frame.image[row].argmax()] == pytest.approx(target.u, abs=0.04)
    assert min(target.velocity_mps for target in frame.targets) < -0.5 * radar.waveform.velocity_span_mps  # 16 m/s
