"""Cubes of other radars than the run's, and estimators in place of a run: what is exact, what is refused.

What ``trainer predict --points`` writes: the column, files for other tools, and lists of whole cubes.
"""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from captured_cubes import OTHER, PLACES, noisy, other_radar, write_capture, write_plain_cube
from command_line import ended
from paper_arrays import RADAR as PAPER_RADAR
from tiny_radar import RADAR, frame, small_dataset
from tiny_run import make_run

from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.radar.arrays import AntennaArray, line
from shared.signal import if_signal
from shared.signal.model_error import NO_MODEL_ERROR_DB, UNCALIBRATED_DB
from shared.signal.windows import cell_noise_power
from trainer import predict
from trainer.data.measurements import open_measurements
from trainer.data.simulation import amplitude_of, in_plane
from trainer.run.answers import estimator_answer
from trainer.run.detection_files import UNITS, write_csv, write_pcd
from trainer.run.detections import Detections
from trainer.run.folder import load_imager
from trainer.run.other_radars import fitted_imager, matching_elements, position_tolerance, training_commands


def test_the_same_places_in_wavelengths_give_the_same_image(tmp_path):
    run, imager = load_imager(make_run(tmp_path / "run"))
    fitted, channels, remarks = fitted_imager(run, imager, "run", other_radar(), "cube.npz")
    assert PLACES[channels].tolist() == [0.0, 1.0, 2.0, 7.0]
    assert len(remarks) == 2
    assert "range bins of 0.0749 m, the run was trained with 0.15 m" in remarks[0]
    assert "4 of its 8 channels stand as those of 'mine' in the run, within 0.000 wavelengths" in remarks[1]
    own = torch.from_numpy(frame(5).range_channel)
    seen = torch.full((*own.shape[:2], 8), 9.0, dtype=own.dtype)
    for channel, place in ((0, 0.0), (1, 1.0), (2, 2.0), (5, 7.0)):
        seen[..., np.flatnonzero(place == PLACES)[0]] = own[..., channel]
    noise = torch.full((3,), 1e-18, dtype=torch.float64)
    with torch.no_grad():
        one, other = imager(own, noise), fitted(seen, noise)
    np.testing.assert_allclose(other, one, rtol=2e-3, atol=1e-3 * float(one.max()))


@pytest.mark.parametrize("stretch", [1.0, 0.934, 1.0812])
def test_elements_are_found_wherever_the_line_stands(stretch):
    generator = np.random.default_rng(0)
    there = generator.uniform(-5.0, 5.0, (30, 2))
    chosen = generator.permutation(30)[:7]
    wanted = there[chosen] / stretch + np.array([3.0, -1.0])
    found, misfit, seen = matching_elements(wanted, there)
    assert found.tolist() == chosen.tolist()
    assert seen == pytest.approx(stretch)
    assert misfit < 1e-12
    found, misfit, seen = matching_elements(wanted + 0.01 * generator.standard_normal((7, 2)), there)
    assert found.tolist() == chosen.tolist()
    assert seen == pytest.approx(stretch, abs=0.01)
    assert 0.005 < misfit < 0.05


def test_elements_that_coincide_are_found_each_once():
    there = np.array([[place, 0.0] for place in (0.0, 1.0, 2.0, 3.0, 3.0, 4.0, 5.0, 6.0)])
    found, misfit, _ = matching_elements(there / 1.002, there)
    assert found.tolist() == list(range(8))
    assert misfit < 1e-12
    assert len(matching_elements(there, there[1:])[0]) == 7


def test_an_array_is_taken_as_far_as_the_truth_s_cell_and_the_stretch_allow(tmp_path):
    run, imager = load_imager(make_run(tmp_path / "run"))
    places = np.array([0.0, 1.0, 2.0, 7.0])
    fitted_imager(run, imager, "run", other_radar(places, 1.09, shift_m=0.01), "cube.npz")
    step = 2e-3 / RADAR.waveform.wavelength_m
    # The third element alone, and the shift of least squares, a quarter of it.
    moved = places + np.array([0.0, 0.0, 1.0, 0.0]) * position_tolerance(run) / step
    fitted_imager(run, imager, "run", other_radar(moved), "cube.npz")
    with pytest.raises(InputError, match="miss a place"):
        fitted_imager(run, imager, "run", other_radar(places + 2.0 * (moved - places)), "cube.npz")
    with pytest.raises(InputError, match="miss a place of 'mine' by") as caught:
        fitted_imager(run, imager, "run", other_radar(places, 1.4), "cube.npz")
    with pytest.raises(InputError, match="its 3 channels are fewer than the 4 of 'mine'; expected a run trained"):
        fitted_imager(run, imager, "run", other_radar(places[:3]), "cube.npz")
    ordered = run.model_copy(update={"config": run.config.model_copy(update={"features": "covariance"})})
    with pytest.raises(InputError, match="its 4 channels come in another order than 'mine', which 'covariance' feat"):
        fitted_imager(ordered, imager, "run", other_radar(places[::-1]), "cube.npz")
    said = str(caught.value)
    assert "\n" not in said
    assert "differs from 'tiny' of run in array.rx_m, waveform.carrier_hz, waveform.bandwidth_hz" in said
    assert "datafactory points --radar RADAR.toml --out build/points" in said
    assert "trainer fit build/points --array full --out build/run" in said
    assert "trainer predict --method likes" in said


def test_the_commands_name_a_preset_where_it_is_one():
    preset = load_radar("iwr1843")
    assert "datafactory points --radar iwr1843 --out build/points, then trainer fit" in training_commands(preset)
    changed = preset.model_copy(update={"array": RADAR.array})
    assert "--radar RADAR.toml --out build/points (the file and the board of trainer" in training_commands(changed)


def test_a_capture_of_another_band_is_imaged_by_the_run(tmp_path):
    cube = write_capture(tmp_path / "cube.npz", other_radar(shift_m=0.003))
    said: list[str] = []
    assert predict([make_run(tmp_path / "run"), cube], tmp_path / "out", announce=said.append) == 1
    assert len(said) == 3
    table = pq.read_table(tmp_path / "out/images.parquet")
    description = json.loads(table.schema.metadata[b"sparseradar"])
    assert description["shapes"]["image"] == [40, RADAR.grid.bins]
    assert description["axes"]["range_m"]["step"] == pytest.approx(OTHER.range_step_m)
    assert (tmp_path / "out/cube.png").is_file()


@pytest.mark.parametrize("method", ["likes", "omp-cfar", "das"])
def test_an_estimator_needs_no_run(tmp_path, method):
    radar = other_radar()
    position = (2.0, 0.4, 0.0)
    cube = write_capture(tmp_path / "cube.npz", radar, [position], model_error_db=-20.0, dead_channels=(1,))
    out = tmp_path / "out"
    assert predict([cube], out, points=True, points_format="csv", method=method) == 1
    table = pq.read_table(out / "images.parquet")
    description = json.loads(table.schema.metadata[b"sparseradar"])
    assert description["model"] == method
    assert description["chosen_array"]["rx"] == [0, 2, 3, 4, 5, 6, 7]
    image = np.array(table["image"][0].values).reshape(description["shapes"]["image"])
    row, column = np.unravel_index(image.argmax(), image.shape)
    distance = np.hypot(2.0, 0.4)
    assert row == round(distance / OTHER.range_step_m)
    assert radar.grid.u[column] == pytest.approx(0.4 / distance, abs=radar.grid.step)
    (target,) = [found for found in table["detections"][0].as_py() if found["amplitude_db"] > -15.0]
    # Near the array: the wave is curved, and the origin is not the middle of these elements.
    assert target["u"] == pytest.approx(0.4 / distance, abs=0.02)
    assert 0.5 < target["probability"] < 1.0
    assert len((out / "detections.csv").read_text().splitlines()) == 1 + len(table["detections"][0])


def test_the_model_error_of_a_cube_is_the_capture_s(tmp_path):
    radar = other_radar()
    for error, expected in ((-20.0, -20.0), (None, UNCALIBRATED_DB)):
        path = write_capture(tmp_path / "cube.npz", radar, model_error_db=error)
        (measurement,) = open_measurements(path, None, "test")[1]
        assert measurement.model_error_db == expected
    plain = write_plain_cube(tmp_path / "plain.npz", np.zeros((8, 64, 8), np.complex64), radar)
    (measurement,) = open_measurements(plain, None, "test")[1]
    assert measurement.model_error_db == NO_MODEL_ERROR_DB
    assert measurement.noise_power == cell_noise_power(radar)


def test_an_estimator_looks_at_living_channels_on_the_line(tmp_path):
    tx = ((0.0, 0.0, 0.0), (0.0, 0.0, 2e-3))
    radar = RADAR.model_copy(update={"array": RADAR.array.model_copy(update={"tx_m": tx})})
    assert estimator_answer("likes", radar, (4,)).channels.tolist() == [0, 2, 6, 8, 10]
    with pytest.raises(InputError, match="channels: all 12 are dead; expected a channel with an echo"):
        estimator_answer("likes", radar, tuple(range(12)))
    said: list[str] = []
    predict([write_capture(tmp_path / "cube.npz", radar)], tmp_path / "out", method="das", announce=said.append)
    assert said[0] == "6 of 12 channels, at other heights than most, are left out"


@pytest.mark.parametrize("dead", [(), (4,)])
def test_an_estimator_sees_elements_that_coincide_once(tmp_path, dead):
    half = 0.5 * RADAR.waveform.wavelength_m
    places = AntennaArray(tx_m=line(half * np.array([0.0, 2.0, 4.0])), rx_m=line(half * np.arange(4.0)))
    radar = RADAR.model_copy(update={"array": places})
    one_tx = AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(half * np.arange(8.0)))
    images, whole = [], []
    for seen, path in (
        (radar, tmp_path / "doubled.npz"),
        (RADAR.model_copy(update={"array": one_tx}), tmp_path / "x.npz"),
    ):
        write_capture(path, seen, dead_channels=dead if seen is radar else ())
        (measurement,) = open_measurements(path, None, "test")[1]
        answer = estimator_answer("das", seen, dead if seen is radar else ())
        images.append(answer.peaks(measurement)[0][0])
        whole.append(answer.image(measurement.cells.range_channel[0], measurement.noise_power))
    row = int(images[1].max(axis=1).argmax())
    # Uniform over eight elements, as of eight RX; as twelve channels its sidelobes would be those of a tapered line.
    np.testing.assert_allclose(images[0][row], images[1][row], atol=0.02 * images[1].max())
    np.testing.assert_allclose(images, whole, rtol=1e-5, atol=1e-5 * images[1].max())


SOME = Detections(
    np.array([10.0, 20.0]), np.array([0.6, -0.8]), np.array([1.5, 0.0]), np.array([-100.0, -120.5]),
    np.array([1e-4, 2e-3]), np.array([0.75, 0.5]), np.array([1e-3, 0.04]), np.array([0.05, 0.05]),
    np.array([0.25, math.nan]), np.array([70, 64]), np.array([30.0, 12.0]), np.array([0.5, 0.0]),
)  # fmt: skip


def test_csv_has_a_line_a_detection(tmp_path) -> None:
    write_csv(tmp_path / "d.csv", [(3, SOME), (4, SOME)])
    with (tmp_path / "d.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["frame_id"] for row in rows] == ["3", "3", "4", "4"]
    assert list(rows[0]) == ["frame_id", *UNITS]
    first = [10.0, 0.6, 1.5, -100.0, 1e-4, 0.75, 1e-3, 0.05, 0.25, 70, 30, 0.5]
    assert [float(rows[0][name]) for name in UNITS] == first
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
    command = ("trainer", "predict", run, data, "--out", tmp_path / "out", "--no-pictures")
    code, _, said = ended(*command, "--points", "--points-format", form)
    assert code == 0, said
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.name != "images.parquet") == files


def test_all_cells_of_a_cube_list_what_the_three_peaks_leave_out(tmp_path) -> None:
    """Twelve targets in one range bin at 9 m, where wave fronts are curved, each at its own Doppler cell."""
    waveform = PAPER_RADAR.waveform.model_copy(update={"chirps": 64})
    radar = PAPER_RADAR.model_copy(update={"waveform": waveform})
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
    waveform = PAPER_RADAR.waveform.model_copy(update={"samples": 256, "range_bins": 240})
    radar, draw = PAPER_RADAR.model_copy(update={"waveform": waveform}), np.random.default_rng(int(speed))
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
