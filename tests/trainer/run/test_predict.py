"""``trainer predict``: images of datasets and cubes, animation, and what is refused."""

import dataclasses
import itertools
import json
from pathlib import Path

import matplotlib.image
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from captured_cubes import noisy, write_plain_cube
from command_line import ended
from PIL import Image, ImageSequence
from tiny_radar import NOISE_POWER, RADAR, frame, small_dataset, tiny, write_dataset
from tiny_run import make_run, run_of

from shared.physics.errors import InputError
from shared.radar import Radar, load_radar
from shared.signal import if_signal
from shared.signal.ego_motion import EgoMotion, StaticWorld
from shared.signal.imaging import steering_weights
from trainer import predict
from trainer.data.measurements import Cells, Measurement, open_measurements
from trainer.run.answers import Circumstances, network_answer
from trainer.run.detection_files import records
from trainer.run.export import export
from trainer.run.folder import load_imager
from trainer.run.pictures import save_animation
from trainer.run.predict import Predictor, merge_peaks
from trainer.run.pretrained import pretrained_run, run_or_pretrained

SPECTRAL = {"model": "spectral-unet"}
PAPER = {"model": "attention-unet", "features": "paper", "target": "class", "width": 4}
SHAPE = (RADAR.waveform.range_bins, RADAR.grid.bins)


def read_images(path):
    table = pq.read_table(path)
    images = {name: np.stack(table[name].to_numpy()).reshape(-1, *SHAPE) for name in ("image", "velocity")}
    return table, images


def test_a_dataset_becomes_images_and_pictures(tmp_path):
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run")
    assert predict([run, data], tmp_path / "out", split="all") == 5
    table, images = read_images(tmp_path / "out/images.parquet")
    assert table["frame_id"].to_pylist() == [0, 1, 100, 101, 200]
    description = json.loads(table.schema.metadata[b"sparseradar"])
    assert description["shapes"]["image"] == list(SHAPE)
    assert description["units"] == {"image": "sqrt(W)", "velocity": "m/s"}
    assert description["axes"]["u"]["start"] == -0.5
    imager = load_imager(run)[1]
    made = frame(101)
    with torch.no_grad():
        peaks = imager(torch.from_numpy(made.range_channel), torch.full((3,), NOISE_POWER)).numpy()
    np.testing.assert_allclose(images["image"][3], peaks.max(axis=0), rtol=1e-5, atol=1e-14)
    pictures = sorted(path.name for path in (tmp_path / "out").glob("*.png"))
    assert pictures == [f"frame-{index:06d}.png" for index in (0, 1, 100, 101, 200)]
    assert (tmp_path / "out/frame-000000.png").read_bytes()[:4] == b"\x89PNG"


def test_doppler_peaks_are_merged_by_maximum_and_keep_their_velocity():
    """Two targets at one range and different velocities: each pixel has the velocity of the peak that shows it."""
    images = np.array([[[2.0, 0.1, 0.0]], [[0.2, 1.0, 0.0]], [[2.0, 0.1, 0.0]]], np.float32)
    image, speed = merge_peaks(images, np.array([[0.0], [9.0], [0.0]], np.float32))
    assert image.tolist() == [pytest.approx([2.0, 1.0, 0.0])]
    assert speed.tolist() == [[0.0, 9.0, 0.0]]


def cube_of_one_target():
    position = np.array([[2.0, 0.4, 0.0]])
    return if_signal(RADAR, position, np.zeros((1, 3)), np.array([1e-6 + 0j])).astype(np.complex64)


def test_a_cube_is_imaged_and_its_target_is_where_it_was_put(tmp_path):
    cube = cube_of_one_target()
    write_plain_cube(tmp_path / "cube.npz", cube, RADAR)
    found, measurements = open_measurements(tmp_path / "cube.npz", None, "test")
    assert found == RADAR
    (measurement,) = measurements
    assert measurement.cells.range_channel.shape == (3, 24, 6)
    row = np.abs(measurement.cells.range_channel[0]).mean(axis=1).argmax()
    assert row == round(np.hypot(2.0, 0.4) / RADAR.waveform.range_step_m)
    run = make_run(tmp_path / "run")
    das = load_imager(run)[1].das(torch.from_numpy(measurement.cells.range_channel[:1]))[0].numpy()
    assert RADAR.grid.u[das[row].argmax()] == pytest.approx(0.4 / np.hypot(2.0, 0.4), abs=RADAR.grid.step)
    assert predict([run, tmp_path / "cube.npz"], tmp_path / "out") == 1
    assert (tmp_path / "out/cube.png").is_file()


@pytest.mark.parametrize(("model", "channels"), [("run", 8), ("das", 12)])
def test_channels_of_an_elevated_tx_are_left_out_and_it_is_said(tmp_path, model, channels):
    """They see the elevation of an echo, which would look like an angle: what they hold changes nothing."""
    raised = RADAR.array.model_copy(update={"tx_m": ((0.0, 0.0, 0.0), (0.0, 4e-3, 2e-3))})
    radar = RADAR.model_copy(update={"array": raised})
    made = write_dataset(tmp_path / "data", {"test": [frame(0, radar)]}, radar)
    other = frame(0, radar)
    other.range_channel[..., radar.array.channel_tx == 1] = 1e-6
    changed = write_dataset(tmp_path / "changed", {"test": [other]}, radar)
    run = [run_of(tmp_path / "run", radar, tiny())] if model == "run" else []
    images = []
    for data in (made, changed):
        said: list[str] = []
        method, out = None if run else model, tmp_path / f"out-{data.name}"
        predict([*run, data], out, method=method, pictures=False, announce=said.append)
        assert f"{channels // 2} of {channels} channels, at other heights than most, are left out" in said
        images.append(read_images(out / "images.parquet")[1]["image"])
    np.testing.assert_array_equal(*images)


def test_of_tx_in_turns_it_is_said_what_is_known_of_velocities(tmp_path):
    waveform = RADAR.waveform.model_copy(update={"multiplexing": "tdm", "chirp_interval_s": 161.2e-6})
    pair = RADAR.array.model_copy(update={"tx_m": ((0.0, 0.0, 0.0), (0.0, 2e-3, 0.0))})
    radar = RADAR.model_copy(update={"waveform": waveform, "array": pair})
    assert radar.velocity_intervals == 2
    velocity = -0.6 * waveform.velocity_span_mps  # of which a Doppler cell says 0.4
    place = np.array([[2.0, 0.4, 0.0]])
    cube = if_signal(radar, place, velocity * place / np.linalg.norm(place), np.array([1e-6 + 0j]))
    write_plain_cube(tmp_path / "cube.npz", cube, radar)
    said: list[str] = []
    run = run_of(tmp_path / "run", radar, tiny())
    assert predict([run, tmp_path / "cube.npz"], tmp_path / "out", pictures=False, announce=said.append) == 1
    assert "resolve 2 Doppler intervals of 12 m/s; velocities hold from -12 to 12 m/s" in said[0]
    table, images = read_images(tmp_path / "out/images.parquet")
    assert json.loads(table.schema.metadata[b"sparseradar"])["conventions"]["velocity"] == said[0]
    row = round(np.linalg.norm(place) / waveform.range_step_m)
    step = waveform.velocity_step_mps
    assert np.abs(images["velocity"][0, row] - velocity).min() < 0.6 * step


def test_a_network_is_told_the_model_error_of_a_capture(tmp_path):
    """As noise: an image with it is that of more noise."""
    answer = network_answer(*load_imager(make_run(tmp_path / "run")))
    snapshots, velocity = frame(5).range_channel[:1], np.zeros((1, 24), np.float32)
    unit = snapshots / np.sqrt(np.mean(np.abs(snapshots[..., [0, 1, 2, 5]]) ** 2, axis=-1, keepdims=True))

    def imaged(noise_power, **told):
        return answer.peaks(Measurement("m", 0, Cells(unit, velocity), noise_power, None, **told))[0]

    np.testing.assert_allclose(imaged(0.0, model_error_db=-10.0), imaged(0.1), rtol=1e-5)
    assert np.abs(imaged(0.1) - imaged(0.0)).max() > 1e-3


@pytest.mark.parametrize("changes", [{}, {"told": 0.5}, SPECTRAL, PAPER], ids=["unrolled", "told", "spectral", "paper"])
def test_a_row_that_stands_in_several_images_is_computed_once(tmp_path, monkeypatch, changes):
    """A peak that repeats the strongest of its range bin: five images, as of all their rows. The paper's features are
    normalised over an image, which needs all its rows."""
    answer = network_answer(*load_imager(make_run(tmp_path / "run", **changes)))
    generator = torch.Generator().manual_seed(3)
    for weights in answer.imager.network.parameters():
        torch.nn.init.normal_(weights, std=0.1, generator=generator)
    snapshots = np.concatenate([frame(5).range_channel, frame(6).range_channel[:2]])
    velocity = np.arange(5, dtype=np.float32)[:, None] + np.linspace(0.0, 0.5, 24, dtype=np.float32)
    again = np.random.default_rng(4).random(velocity.shape) < 0.5
    again[0] = False
    snapshots, velocity = np.where(again[..., None], snapshots[0], snapshots), np.where(again, velocity[0], velocity)
    motion = EgoMotion.of_vehicle(3.0, 0.0, 0.0) if changes == {"told": 0.5} else None
    measurement = Measurement("m", 0, Cells(snapshots, velocity), NOISE_POWER, None, motion=motion)
    computed, features = [], answer.imager.features

    def counted(rows, *more):
        computed.append(rows.shape[:2])
        return features(rows, *more)

    monkeypatch.setattr(answer.imager, "features", counted)
    found = answer.peaks(measurement)
    world = None if motion is None else StaticWorld(motion, velocity, answer.radar)
    expected = answer.images(snapshots, Circumstances(NOISE_POWER, world=world))
    assert computed == [(5, 24) if changes is PAPER else (1, (~again).sum()), (5, 24)]
    for one, other in zip(found, expected, strict=True):
        if one is None or other is None:
            assert one is other
        else:
            assert np.abs(one - other).max() < 2e-3 * np.abs(other).max()


def test_a_network_that_comes_with_the_package_is_meant_by_its_name_unless_a_folder_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_or_pretrained(Path("sparse6")) == pretrained_run("sparse6")
    make_run(tmp_path / "sparse6", **SPECTRAL)
    assert run_or_pretrained(Path("sparse6")) == Path("sparse6")
    assert export(Path("sparse6"), Path("network.onnx")).difference <= 1e-4


def test_every_frame_is_a_picture_in_its_order(tmp_path):
    data, run, out = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run"), tmp_path / "out"
    options = ("--split", "all", "--no-pictures", "--points", "--animation")
    code, _, said = ended("trainer", "predict", run, data, "--out", out, *options)
    assert code == 0, said
    with Image.open(out / "animation.gif") as film:
        pictures = [np.asarray(picture.convert("RGB")) for picture in ImageSequence.all_frames(film)]
    assert len(pictures) == 5
    assert pictures[0].shape[1] > 2 * 200
    differences = [np.abs(one.astype(int) - other).max() for one, other in itertools.pairwise(pictures)]
    assert min(differences) > 50
    assert save_animation(out / "images.parquet", out / "again.gif") == 5
    assert (out / "again.gif").read_bytes() == (out / "animation.gif").read_bytes()
    assert sorted(path.name for path in out.iterdir()) == ["again.gif", "animation.gif", "images.parquet"]


WAVEFORM = RADAR.waveform.model_copy(update={"chirps": 128, "bandwidth_hz": 5e7})
STREET = RADAR.model_copy(update={"waveform": WAVEFORM})
"""Doppler cells of 0.19 m/s, range bins of 3 m."""


def moving_dataset(path, speed):
    """A street of resting targets seen from a car at this speed, and one that moves: Doppler cells folded."""
    generator, period, step = np.random.default_rng(3), WAVEFORM.velocity_span_mps, WAVEFORM.velocity_step_mps
    made = frame(7, STREET)
    echoes = np.conj(steering_weights(RADAR, np.arange(6)) * 6)
    at = generator.permutation(20)[np.arange(24) % 20]
    rates = -speed * np.sqrt(1.0 - RADAR.grid.u[at] ** 2)
    rates[23] += 0.5 * period
    velocity = ((np.rint(rates / step) + 64.0) % 128.0 - 64.0) * step
    rows = 1e-6 * echoes[:, at].T.astype(np.complex64)
    moved = dataclasses.replace(
        made, sensor_velocity=(0.0, speed, 0.0), sensor_orientation=(0.5**0.5, 0.0, 0.0, 0.5**0.5),
        range_channel=np.stack(3 * [rows]), velocity=np.stack(3 * [velocity]).astype(np.float32),
    )  # fmt: skip
    return write_dataset(path, {"test": [moved]}, STREET)


@pytest.mark.parametrize("speed", [20.0, 31.0])
def test_lines_that_do_not_fit_the_static_world_are_marked(tmp_path, speed):
    """Beyond the Doppler axis of +-12 m/s. The frame's pose looks along the world's y, as the car goes."""
    data, out = moving_dataset(tmp_path / "data", speed), tmp_path / "out"
    predict([data], out, method="likes-view-ego", pictures=False, points=True)
    table = pq.read_table(out / "images.parquet")
    assert table["motion"].to_pylist() == [
        {"forward": pytest.approx(speed), "left": pytest.approx(0.0, abs=1e-9), "forward_std": 0.0, "left_std": 0.0}
    ]
    (found,) = table["detections"].to_pylist()
    moving = [line for line in found if round(line["range"] / WAVEFORM.range_step_m) == 23]
    still = [line for line in found if line not in moving and line["range"] > 10.0]
    assert len(moving) == 1
    # It is not of the static world; that it moves is then as likely as an echo of this probability allows.
    odds = (moving[0]["probability"] / (1.0 - moving[0]["probability"]) / 16.0) ** 2
    assert 0.99 < moving[0]["moving"] / (odds / (1.0 + odds)) <= 1.0
    assert moving[0]["moving"] > 0.5
    assert len(still) > 15
    assert max(line["moving"] for line in still) < 0.1


def test_a_picture_shows_points_beside_the_images_and_those_that_move_in_cyan(tmp_path):
    data, shown = moving_dataset(tmp_path / "data", 20.0), {}
    for points in (False, True):
        predict([data], tmp_path / f"points-{points}", method="likes-view-ego", points=points)
        (file,) = (tmp_path / f"points-{points}").glob("*.png")
        shown[points] = matplotlib.image.imread(file)[..., :3]
    assert shown[True].shape[1] == shown[False].shape[1] * 4 // 3
    cyan = {points: (abs(image - (0.0, 1.0, 1.0)).max(axis=-1) < 0.1).sum() for points, image in shown.items()}
    assert cyan[True] > cyan[False] == 0


def test_the_command_goes_before_the_file_and_the_file_before_the_frame(tmp_path):
    write_plain_cube(tmp_path / "cube.npz", cube_of_one_target(), RADAR)
    said: list[str] = []

    def motion(**changes):
        out = tmp_path / f"out-{len(list(tmp_path.iterdir()))}"
        request = {"method": "das", "pictures": False, "points": True, **changes}
        predict([tmp_path / "cube.npz"], out, announce=said.append, **request)
        table = pq.read_table(out / "images.parquet")
        return table["motion"].to_pylist()[0], table["detections"].to_pylist()[0]

    seen, lines = motion()
    assert seen is None
    assert lines
    assert {line["moving"] for line in lines} == {None}
    assert said[0].startswith("the sensor's velocity was estimated in 0 of 1 frames; in 1 too few echoes agree")
    side = tmp_path / "cube.motion.json"
    side.write_text(json.dumps({"velocity": [[4.0, 0.0]], "mounting_yaw_deg": 90.0}))
    seen, lines = motion()
    assert (seen["forward"], seen["left"]) == pytest.approx((0.0, -4.0), abs=1e-9)
    assert all(0.0 < line["moving"] < 1.0 for line in lines)
    told, _ = motion(velocity=(2.0, 1.0), mounting_yaw_deg=-90.0)
    assert (told["forward"], told["left"]) == pytest.approx((-1.0, 2.0))
    for text, problem in [
        ('{"velocity": [1.0]}', r"velocity\.1 missing; expected a value"), ("{", "not readable as JSON"),
        ('{"velocity": [[1, 0], [2, 0]]}', "2 velocities"), ('{"velocity": [1, 0], "yaw": 3}', "unknown field yaw"),
    ]:  # fmt: skip
        side.write_text(text)
        with pytest.raises(InputError, match=problem):
            motion()


@pytest.mark.parametrize("seed", range(3))
def test_the_cells_of_few_echoes_are_no_static_world(seed: int) -> None:
    """Two that move and two that stand show in dozens of cells, which agree with a car that slides sideways."""
    radar = load_radar("iwr1843")
    u, range_m, rate = np.array([0.34, -0.57, 0.09, 0.64]), np.array([8.0, 12.0, 15.5, 20.0]), [1.5, -2.0, 0.0, 0.0]
    along = np.stack([np.sqrt(1.0 - u**2), u, np.zeros(4)], axis=1)
    places, velocities = range_m[:, None] * along, np.array(rate)[:, None] * along
    cube = if_signal(radar, places, velocities, np.full(4, 1e-5 + 0j))
    seen = Predictor.load("das", radar).cube(noisy(cube[None], radar, np.random.default_rng(seed))[0])
    assert seen.points is not None
    assert len(seen.points.range_m) >= 4
    assert seen.measurement.motion is None


@pytest.mark.parametrize("model", ["das", "sparse6"])
def test_cubes_one_by_one_give_what_the_command_gives(tmp_path, model: str) -> None:
    radar = Radar()
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"chirps": 4})})
    echo = if_signal(radar, np.array([[20.0, 3.0, 0.0]]), np.zeros((1, 3)), np.array([1e-6 + 0j]))
    cubes = noisy(np.stack([echo, echo]), radar, np.random.default_rng(2))
    write_plain_cube(tmp_path / "cube.npz", cubes, radar)
    method, pretrained = (model, None) if model == "das" else (None, model)
    predict(
        tmp_path / "cube.npz", tmp_path / "out", method=method, pretrained=pretrained, pictures=False, points=True
    )  # fmt: skip
    table = pq.read_table(tmp_path / "out" / "images.parquet")
    predictor = Predictor.load(model, radar)
    for number, cube in enumerate(cubes):
        seen = predictor.cube(cube, number)
        assert seen.points is not None
        np.testing.assert_array_equal(seen.image.ravel(), table["image"][number].values)
        assert records(seen.points) == table["detections"][number].as_py()
        assert seen.points.range_m[0] == pytest.approx(np.hypot(20.0, 3.0), abs=0.05)


OF_THE_RADAR = "complex64 [chirp, sample, channel] = [4, 32, 6] of radar 'tiny'"


@pytest.mark.parametrize(
    ("cube", "problem", "expected"),
    [
        (np.zeros((4, 32), complex), "is complex128 [4, 32]", OF_THE_RADAR),
        (np.zeros((4, 32, 5), complex), "is complex128 [4, 32, 5]", OF_THE_RADAR),
        (np.zeros((1, 4, 32, 6), complex), "is complex128 [1, 4, 32, 6]", OF_THE_RADAR),
        (np.zeros((4, 32, 6)), "is float64 [4, 32, 6]", OF_THE_RADAR),
        (np.full((4, 32, 6), np.nan, complex), "has 768 values that are not finite", "finite samples"),
        (np.full((4, 32, 6), 1e30, complex), "has samples of 1e+30", "at most 1e+12"),
    ],
)
def test_a_frame_that_is_no_cube_of_the_radar_is_one_line(cube: np.ndarray, problem: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        Predictor.load("das", RADAR).cube(cube)
    assert str(caught.value) == f"cube: cube {problem}; expected {expected}"


def test_a_model_that_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match=r"'sparse7'; expected the folder of a run, or one of sparse4, sparse6, das"):
        Predictor.load("sparse7", RADAR)
