"""``trainer fit``: it learns, is repeatable, begins with other weights, keeps the best, takes first frames alone."""

import json
import shutil
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np
import pytest
import torch
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem
from safetensors.torch import load_file
from tiny_radar import RADAR, TINY, frame, tiny, write_dataset
from tiny_run import last_state, metrics, run, run_of

from shared.dataset.locations import RemotePath
from shared.physics.errors import InputError
from shared.signal.imaging import steering_matrix
from shared.signal.signal import manifold
from trainer import fit, predict
from trainer.data.dataset import ShardDataset
from trainer.run.configuration import CALIBRATED, FitConfig
from trainer.run.folder import METRICS, WEIGHTS, load_imager, read_run, save_weights
from trainer.run.imager import Imager
from trainer.training.datamodule import ImagingData


def test_eight_frames_are_learned_by_heart(dataset, tmp_path):
    """The loss of the training frames, 0.045 for an empty image, falls below 0.004."""
    steps = {"steps": 240, "validate_every": 240}
    config = TINY.model_copy(update=steps | {"hidden": 96, "batch": 8, "learning_rate": 1e-2, "weight_decay": 0.0})
    run(dataset, tmp_path / "run", config)
    last = metrics(tmp_path / "run")[-1]
    assert float(last["train_loss"]) < 0.004


def validation_nmse(imager, dataset):
    """Error of the linear image with the one gain that errs least, as :class:`ImagingTask` has it."""
    projections, energies = [], []
    frames = ShardDataset(dataset, "validation")
    for stored in (frames[index] for index in range(len(frames))):
        with torch.inference_mode():
            image = imager(stored["range_channel"][:1], stored["noise_power"][None])[0].double() / stored["image_peak"]
        truth = stored["image"].double()
        projections.append((image * truth).sum() / truth.square().sum())
        energies.append(image.square().sum() / truth.square().sum())
    return float(1.0 - np.mean(projections) ** 2 / np.mean(energies))


def flashed(index):
    """A frame with an echo of 80 dB from beside the image: in its row the truth has the sensor's sidelobes alone."""
    stored, row, u, amplitude = frame(index), 12, 0.8, 1e-5
    wavelength = RADAR.waveform.wavelength_m
    seen = stored.range_channel.copy()
    seen[:, row] += amplitude * manifold(RADAR.array.virtual[:, 1], wavelength, u)
    image = stored.image * stored.image_peak
    sensor = RADAR.virtual_sensor
    image[row] += amplitude * np.abs(
        manifold(sensor.virtual[:, 1], wavelength, u) @ steering_matrix(RADAR, sensor) / sensor.channels
    )
    peak = float(image.max())
    return replace(stored, range_channel=seen, image=(image / peak).astype(np.float32), image_peak=peak)


@pytest.mark.parametrize("learned", [0, 2])
def test_the_weights_kept_are_no_worse_than_the_view_that_training_begins_with(tmp_path, learned):
    """Beside rows of 80 dB in which nothing else stands, where thirty steps can make an image worse."""
    frames = {"train": [frame(i) for i in range(8)], "validation": [flashed(100), flashed(101)], "test": [frame(200)]}
    dataset = write_dataset(tmp_path / "data", frames)
    config = FitConfig(iterations=8, learned=learned, rows=0, points=1, steps=30, validate_every=30)
    result, _ = run(dataset, tmp_path / "run", config)
    view = Imager(result.config, result.radar, result.array)  # untrained
    rows = {row["step"]: row for row in metrics(tmp_path / "run")}
    best = min(rows.values(), key=lambda row: float(row["validation_loss"]))
    found, first = (validation_nmse(imager, dataset) for imager in (load_imager(tmp_path / "run")[1], view))
    assert float(best["validation_loss"]) <= float(rows["0"]["validation_loss"])
    assert float(rows["0"]["validation_nmse"]) == pytest.approx(first, rel=1e-3)
    assert float(best["validation_nmse"]) == pytest.approx(found, rel=1e-3)


@pytest.mark.parametrize(
    ("steps", "validate_every", "validations"),
    [(4, 2, [0, 2, 4]), (6, 4, [0, 3, 6]), (3, 9, [0, 3]), (7, 3, [0, 2, 4, 6])],
)
def test_the_last_validation_is_at_the_end(dataset, tmp_path, steps, validate_every, validations):
    """What is learned after it would be lost; but for the rest of a division."""
    config = TINY.model_copy(update={"steps": steps, "validate_every": validate_every})
    run(dataset, tmp_path / "run", config)
    assert [int(row["step"]) for row in metrics(tmp_path / "run")] == validations


def test_a_run_says_what_it_was_made_with(dataset, tmp_path):
    result, lines = run(dataset, tmp_path / "run")
    assert read_run(tmp_path / "run") == result
    assert result.array.rx == (0, 1, 2, 3, 4, 5)
    assert not load_imager(tmp_path / "run")[1].training
    document = json.loads((tmp_path / "run/run.json").read_text())
    assert document["config"]["seed"] == 3
    assert document["datasets"][0]["frames"] == {"train": 8, "validation": 2, "test": 1}
    assert len(document["datasets"][0]["sha256"]) == 64
    assert document["versions"]["torch"] == version("torch")
    assert document["radar"]["array"]["rx_m"] == [list(position) for position in RADAR.array.rx_m]
    rows = metrics(tmp_path / "run")
    assert [row["step"] for row in rows] == ["0", "2", "4"]
    assert rows[0]["train_loss"] == ""
    assert 0 < float(rows[0]["das_nmse"]) < 1
    assert any(path.name.startswith("events") for path in (tmp_path / "run/tensorboard").iterdir())
    assert "full" in lines[0]


def test_another_seed_gives_other_weights(dataset, ordinary, tmp_path):
    """That the same one gives the same stands in ``test_a_killed_run_resumed_ends_in_the_same_weights``."""
    run(dataset, tmp_path / "run", TINY.model_copy(update={"seed": 4}))
    assert (tmp_path / "run" / WEIGHTS).read_bytes() != (ordinary / WEIGHTS).read_bytes()


def test_imperfections_stand_in_the_run_and_change_what_it_learns(dataset, ordinary, tmp_path):
    config = TINY.model_copy(update={"imperfections": CALIBRATED})
    run(dataset, tmp_path / "imperfect", config)
    assert read_run(tmp_path / "imperfect").config.imperfections == CALIBRATED
    document = json.loads((tmp_path / "imperfect/run.json").read_text())
    assert document["config"]["imperfections"]["phase_deg"] == [2.0, 5.0]
    one, other = last_state(ordinary), last_state(tmp_path / "imperfect")
    assert any(not torch.equal(tensor, other[name]) for name, tensor in one.items())


def test_a_run_begins_with_the_weights_of_another(dataset, ordinary, tmp_path):
    still = TINY.model_copy(update={"learning_rate": 1e-12, "weight_decay": 0.0})
    result, _ = run(dataset, tmp_path / "second", still, start=ordinary)
    before, after = (load_file(folder / WEIGHTS) for folder in (ordinary, tmp_path / "second"))
    for name, tensor in before.items():
        torch.testing.assert_close(after[name], tensor, rtol=1e-4, atol=1e-7)
    assert result.start is not None
    assert result.start.name == "first"
    assert read_run(tmp_path / "second").start == result.start
    assert [fingerprint.name for fingerprint in result.trained_on] == ["data", "data"]


def test_weights_survive_the_run_folder_bit_for_bit(tmp_path):
    folder = run_of(tmp_path / "run", RADAR, TINY)
    stored = read_run(folder)
    imager = Imager(stored.config, stored.radar, stored.array)  # other weights than the folder has
    save_weights(folder, imager)
    again = load_imager(folder)[1].network.state_dict()
    before = imager.network.state_dict()
    assert before.keys() == again.keys()
    assert all(torch.equal(tensor, again[name]) for name, tensor in before.items())


def test_a_run_that_no_longer_improves_stops_early(dataset, tmp_path):
    """Two validations no better than the one before the first step; resumed, it trains no more."""
    config = TINY.model_copy(update={"steps": 40, "validate_every": 1, "patience": 2, "learning_rate": 1e-30})
    _, lines = run(dataset, tmp_path / "run", config, start="none")
    assert [row["step"] for row in metrics(tmp_path / "run")] == ["0", "1", "2"]
    assert [line for line in lines if line.endswith("ends: the 2. without gain")]
    before = last_state(tmp_path / "run")
    run(dataset, tmp_path / "run", config, start="none", resume=True)
    assert [row["step"] for row in metrics(tmp_path / "run")] == ["0", "1", "2"]
    assert all(torch.equal(tensor, before[name]) for name, tensor in last_state(tmp_path / "run").items())


def test_the_best_weights_are_those_of_the_least_loss(dataset, tmp_path):
    run(dataset, tmp_path / "run", TINY.model_copy(update={"steps": 8, "validate_every": 1}))
    rows = metrics(tmp_path / "run")
    best = min(rows, key=lambda row: float(row["validation_loss"]))
    imager = load_imager(tmp_path / "run")[1]
    assert imager.gain == pytest.approx(float(best["validation_gain"]), rel=1e-6)
    # What the metrics say is what the weights and the gain give.
    errors = []
    for index in (100, 101):
        made = frame(index)
        snapshot, noise = torch.from_numpy(made.range_channel[:1]), torch.tensor([made.noise_power])
        with torch.no_grad():
            estimate = imager(snapshot, noise)[0].numpy() / made.image_peak
        errors.append(((estimate - made.image) ** 2).sum() / (made.image**2).sum())
    assert np.mean(errors) == pytest.approx(float(best["validation_nmse"]), rel=1e-4)


def test_a_dataset_in_another_place_trains_the_same_weights(dataset, ordinary, tmp_path):
    """By URI, and through a filesystem of Arrow's as object storage is: same bytes, and the same name in the run."""
    place = RemotePath(SubTreeFileSystem(str(dataset.parent), LocalFileSystem()), "data", "memory://bucket/data")
    for name, source in (("uri", dataset.as_uri()), ("remote", place)):
        run(source, tmp_path / name)
        for file in (WEIGHTS, METRICS, "run.json", "verdict.json"):
            assert (tmp_path / name / file).read_bytes() == (ordinary / file).read_bytes(), file
    for name, source in (("local", dataset), ("remote", place)):
        predict([ordinary, source], tmp_path / f"images-{name}")
    assert (tmp_path / "images-remote/images.parquet").read_bytes() == (
        tmp_path / "images-local/images.parquet"
    ).read_bytes()


BESIDES: dict[str, Any] = {"workers": 0, "check": False, "logger": "none"}


def city(directory, frames=16):
    """Every fourth frame is for validation. Cities of other names have other frames."""
    made = [replace(frame(index), scene=directory.name) for index in range(frames)]
    return write_dataset(
        directory,
        {
            "train": [one for one in made if one.frame_id % 4 != 3],
            "validation": [one for one in made if one.frame_id % 4 == 3],
        },
    )


def ids(frames):
    return [int(frames[index]["frame_id"]) for index in range(len(frames))]


def test_the_first_frames_are_those_of_small_index_in_every_split(tmp_path):
    folder = city(tmp_path / "city")
    assert ids(ShardDataset(folder, "train", first=8)) == [0, 1, 2, 4, 5, 6]
    assert ids(ShardDataset(folder, "validation", first=8)) == [3, 7]
    assert len(ShardDataset(folder, "train")) == len(ShardDataset(folder, "train", first=16)) == 12


def test_one_world_and_four_give_as_many_frames(tmp_path):
    cities = [city(tmp_path / f"city-{index}") for index in range(4)]
    one = ImagingData(cities[:1], None, tiny(frames=16))
    four = ImagingData(cities, None, tiny(frames=4))
    assert [len(part) for part in one.training] == [12]
    assert [len(part) for part in four.training] == [3, 3, 3, 3]
    assert len(one.validation) == len(four.validation) == 4
    assert [fingerprint.frames for fingerprint in four.fingerprints] == [{"train": 3, "validation": 1, "test": 0}] * 4
    assert [fingerprint.scenes for fingerprint in four.fingerprints] == [None] * 4
    again = shutil.copytree(cities[1], tmp_path / "again")
    with pytest.raises(InputError, match=r"again: the same shards as .*city-1; expected each dataset once; --weight"):
        ImagingData([*cities, again], None, tiny(frames=4))


@pytest.mark.parametrize(("first", "seen"), [(0, ["a", "b"]), (4, ["a"]), (8, ["a", "b"])])
def test_the_scenes_of_a_run_are_those_of_frames_that_train_or_validate(tmp_path, first, seen):
    frames = [replace(frame(index), kind="scene", scene="b" if index == 7 else "a") for index in range(8)]
    tested = [replace(frame(8), kind="scene", scene="tested alone")]
    folder = write_dataset(tmp_path / "data", {"train": frames[:3], "validation": frames[3:], "test": tested})
    scenes = [{"name": name, "content_sha256": name} for name in ("a", "b", "tested alone")]
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "scenes": scenes}))
    (fingerprint,) = ImagingData([folder], None, tiny(frames=first)).fingerprints
    assert fingerprint.scenes is not None
    assert [scene.name for scene in fingerprint.scenes] == seen


def test_too_few_frames_are_refused(tmp_path):
    folder = city(tmp_path / "city")
    with pytest.raises(InputError, match="no frames in split 'validation' among the first 3 frames"):
        ImagingData([folder], None, tiny(frames=3))
    late = write_dataset(tmp_path / "late", {"train": [frame(9)], "validation": [frame(0)]})
    with pytest.raises(InputError, match="no frame of split 'train' among the first 3"):
        ImagingData([late], None, tiny(frames=3))
    # One dataset of several may be without.
    without = write_dataset(tmp_path / "without", {"train": [frame(0)]})
    data = ImagingData([without, folder], None, tiny(frames=4))
    assert len(data.validation) == 1


def test_the_same_frames_and_seed_are_the_same_weights(tmp_path):
    """What lies behind the first frames changes nothing, in the best weights nor in the last, which saw all steps."""
    long, short = city(tmp_path / "long", 16), city(tmp_path / "short", 8)
    for name, folder, frames in (("a", long, 8), ("b", short, 0)):
        fit([folder], tmp_path / name, config=tiny(frames=frames, steps=2), array="full", **BESIDES)
    one, other = (tmp_path / name for name in "ab")
    assert (one / WEIGHTS).read_bytes() == (other / WEIGHTS).read_bytes()
    last = last_state(other)
    assert all(torch.equal(tensor, last[name]) for name, tensor in last_state(one).items())
