"""The verdict: a perfect image scores 0 and 1, an empty one 1 and 0, and the numbers are those of the definition."""

import json

import numpy as np
import pytest
import torch
from tiny_radar import RADAR, TINY, frame, small_dataset, tiny, write_dataset

from trainer.data.arrays import ArrayChoice
from trainer.metrics.detection import Counts
from trainer.run.folder import Run, load_imager, save_weights, write_run
from trainer.run.imager import Imager
from trainer.training import verdict as module
from trainer.training.fit import fit
from trainer.training.verdict import PICTURE, THRESHOLDS_DB, VERDICT, count_matches, judge, row_peaks

FULL = ArrayChoice(name="full", rx=tuple(range(6)))


def make_run(directory, network=None, gain=1.0, **changes):
    config = tiny(**{"model": "spectral-unet", **changes})
    imager = Imager(config, RADAR, FULL)
    directory.mkdir()
    write_run(directory, Run(config=config, radar=RADAR, array=FULL, datasets=()))
    save_weights(directory, imager, gain)
    return directory


def loader(monkeypatch, network):
    """load_imager, but with a network whose answer is known."""

    def load(directory):
        run, imager = load_imager(directory)
        imager.network = network
        return run, imager

    monkeypatch.setattr(module, "load_imager", load)


class Das(torch.nn.Module):
    """Delay-and-sum itself, as an answer to the "row" target."""

    def forward(self, features):
        return features[:, 2:3].sqrt()


class Nothing(torch.nn.Module):
    def forward(self, features):
        return torch.zeros_like(features[:, :1])


def test_peaks_are_found_along_each_row_down_to_the_level():
    image = np.zeros((8, 20), np.float32)
    image[2, [4, 8]] = 1.0, 0.5
    image[4, 0] = 0.5  # at the edge, and as strong as the first once weighted by range
    image[6, 10] = 1e-3
    peaks = row_peaks(image, -30.0)
    assert peaks[:, :2].tolist() == [[2, 4], [2, 8], [4, 0]]
    np.testing.assert_allclose(peaks[:, 2], [0.0, 20 * np.log10(0.5), 0.0], atol=1e-6)
    assert len(row_peaks(image, -60.0)) == 4
    assert len(row_peaks(np.zeros((8, 20), np.float32), -30.0)) == 0
    flat = np.zeros((8, 20), np.float32)
    flat[3, 5:8] = 1.0, 0.8, 0.98  # a dip of 2 dB parts nothing
    assert len(row_peaks(flat, -30.0)) == 1


def test_matching_is_one_to_one():
    truth = np.array([[3, 10, 0.0], [3, 14, 0.0], [5, 4, 0.0]])
    image = np.zeros((8, 20), np.float32)
    image[3, 11], image[5, 9] = 1.0, 0.5
    counts = count_matches(image, truth)
    # One estimate cannot stand for two targets, and one five bins away for none.
    assert counts[0] == counts[-1] == Counts(1, 1, 2)
    assert counts[0].f1 == 0.4
    image[5, 9] = 0.1
    assert count_matches(image, truth)[-1] == Counts(1, 0, 2)


def verdict_of(run, datasets):
    found = judge(run, datasets, announce=str)
    assert found is not None
    return found


def test_the_truth_scores_one_and_an_empty_image_nothing():
    truth = frame(3).image
    peaks = row_peaks(truth, -30.0)
    assert count_matches(truth, peaks)[THRESHOLDS_DB.index(-30.0)].f1 == 1.0
    assert max(counts.f1 for counts in count_matches(np.zeros_like(truth), peaks)) == 0.0


def test_delay_and_sum_as_a_network_scores_as_delay_and_sum(tmp_path, monkeypatch):
    data, run = small_dataset(tmp_path / "data", training=3), make_run(tmp_path / "run")
    loader(monkeypatch, Das())
    found = verdict_of(run, [data])
    assert found.frames == 1
    assert found.f1["network"] == found.f1["das"] > 0
    assert found.threshold_db["network"] == found.threshold_db["das"]
    assert found.nmse["network"] >= found.nmse["das"] > 0
    assert found.nmse["zero"] == 1.0
    assert found.nmse["das"] < found.nmse["mean"] < 1.0
    assert json.loads((run / VERDICT).read_text())["nmse"] == found.nmse
    assert (run / PICTURE).read_bytes()[:4] == b"\x89PNG"


def test_the_gain_of_the_run_multiplies_the_image(tmp_path, monkeypatch):
    data = small_dataset(tmp_path / "data", training=2)
    loader(monkeypatch, Das())
    errors = [verdict_of(make_run(tmp_path / str(g), gain=g), [data]).nmse["network"] for g in (1.0, 3.0)]
    assert errors[1] > errors[0] + 1.0


def test_an_empty_network_scores_as_the_zero_image(tmp_path, monkeypatch):
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run")
    loader(monkeypatch, Nothing())
    found = verdict_of(run, [data])
    assert found.nmse["network"] == found.nmse["zero"] == 1.0
    assert found.f1["network"] == 0.0


def test_frames_without_a_truth_are_counted_and_do_not_count(tmp_path, monkeypatch):
    empty = type(frame(0))(**{**vars(frame(0)), "image": np.zeros((24, 20), np.float32), "image_peak": 0.0})
    splits = {"train": [frame(0)], "validation": [frame(1)], "test": [frame(2), empty]}
    data, run = write_dataset(tmp_path / "data", splits), make_run(tmp_path / "run")
    found = verdict_of(run, [data])
    assert (found.frames, found.empty_frames) == (1, 1)
    lines: list[str] = []
    nothing = write_dataset(tmp_path / "none", {"train": [frame(0)], "validation": [frame(1)]})
    assert judge(run, [nothing], announce=lines.append) is None
    assert lines == ["no test frames with a truth: no verdict"]


def test_a_class_probability_has_no_amplitude_to_judge(tmp_path):
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run", target="class")
    found = verdict_of(run, [data])
    assert found.nmse == {}
    assert set(found.f1) == {"network", "das"}


def test_fit_ends_with_the_verdict_of_its_best_weights(tmp_path):
    data = small_dataset(tmp_path / "data")
    lines: list[str] = []
    fit([data], tmp_path / "run", TINY, array="full", announce=lines.append)
    assert lines[-1].startswith("test split, 1 frames")
    document = json.loads((tmp_path / "run" / VERDICT).read_text())
    assert document["gain"] == pytest.approx(load_imager(tmp_path / "run")[1].gain)
    assert document["gain"] != 1.0
    assert verdict_of(tmp_path / "run", [data]).nmse == document["nmse"]
