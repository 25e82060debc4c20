"""Scores of images whose score is known, and the frames that are shown."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_evaluation import FULL, RADAR, strong_frame
from tiny_radar import frame

from shared.dataset import Target
from trainer.evaluation.experiments.bench import FrameRef
from trainer.evaluation.experiments.contenders import estimator_contender
from trainer.evaluation.experiments.doppler import score_peaks
from trainer.evaluation.experiments.frames import FrameScores, one_of_each_scene, score_frame, score_truth
from trainer.evaluation.report.page import from_bytes, scene_levels, to_bytes
from trainer.metrics.cells import truth_cells
from trainer.run.answers import Answer
from trainer.run.imager import AMPLITUDE


@dataclass(frozen=True, eq=False)
class Known(Answer):
    """Answers with what a function says."""

    function: Any
    unit: str = AMPLITUDE
    detects: bool = False

    def images(self, range_channel, told):
        return self.function(range_channel, told.noise_power)

    def peaks(self, measurement):
        raise AssertionError("one peak is scored here")

    baseline = peaks


def known(image, **changes):
    """A contender that answers with this image [R, U]."""
    return answering(lambda *_: (image[None], None), **changes)


def answering(function, **changes):
    contender = estimator_contender("das", FULL, RADAR)
    given = {field.name: getattr(contender.answer, field.name) for field in fields(Answer)}
    return replace(contender, answer=Known(**(given | changes), function=function))


def test_the_truth_scores_one_an_empty_image_nothing_and_noise_between():
    made = frame(3, RADAR)
    truth = made.image.astype(np.float64) * made.image_peak
    perfect = score_frame(known(truth), made)
    tp, fp, fn = perfect["strict"][0]
    assert tp > 10
    assert (fp, fn) == (0, 0)
    assert perfect["nmse"] == perfect["scaled_nmse"] == 0.0
    assert perfect["ssim"] == 1.0
    empty = score_frame(known(np.zeros_like(truth)), made)
    assert empty["strict"][0].tolist() == [0, 0, tp + fn]
    assert empty["nmse"] == empty["scaled_nmse"] == 1.0
    noise = np.random.default_rng(0).rayleigh(truth.max(), truth.shape)
    white = score_frame(known(noise), made)
    assert white["strict"][0][1] > fp
    assert 0.5 < white["scaled_nmse"] < 1.0
    assert white["ssim"] < 0.5


def test_an_empty_truth_has_no_image_errors_and_every_detection_is_false():
    made = replace(frame(3, RADAR), image=np.zeros((48, 20), np.float32))
    scores = score_frame(estimator_contender("das", FULL, RADAR), made)
    assert np.isnan([scores[name] for name in ("nmse", "scaled_nmse", "ssim")]).all()
    assert scores["strict"][0][0] == 0
    assert scores["strict"][0][1] > 0


def average_precision(contender, made):
    values = score_frame(contender, made)
    refs = [FrameRef(Path("p"), 0, 0, "scene", "hall")]
    results = {(*contender.key, refs[0].condition): values}
    return FrameScores(results, refs).ranking(contender.key).average_precision()


def test_the_truth_has_all_the_precision_an_empty_image_none_and_delay_and_sum_some():
    made = strong_frame(3)
    truth = made.image.astype(np.float64) * made.image_peak
    ceiling = score_truth(RADAR, FULL, made)
    assert len(ceiling["cells_matched"]) == ceiling["cells_true"] > 3
    assert not len(ceiling["cells_false"])
    assert average_precision(known(truth), made) == 1.0
    assert average_precision(known(np.zeros_like(truth)), made) == 0.0
    assert 0.0 < average_precision(estimator_contender("das", FULL, RADAR), made) < 1.0


def test_detections_are_found_and_ranked_by_the_score_where_a_method_has_one():
    """The image has everything and no order; the score has the truth's maxima alone."""
    made = strong_frame(3)
    truth = made.image.astype(np.float64) * made.image_peak
    loud = np.random.default_rng(0).rayleigh(truth.max(), truth.shape)
    calls = []

    def answer(range_channel, noise):
        calls.append((range_channel.shape, noise))
        return loud[None], (truth[None] / loud) ** 2

    assert average_precision(known(loud), made) < 0.5
    assert average_precision(answering(answer, detects=True), made) == 1.0
    assert calls == [((1, 48, 6), made.noise_power)]  # one pass for image and score


def test_a_probability_is_read_by_delay_and_sum():
    """Sure of the truth's maxima, and of one bin more: it is a false alarm if the data are strong there."""
    made = strong_frame(3)
    image = made.image.copy()
    image[41:46] = 0.0
    made = replace(made, image=image)
    truth = made.image.astype(np.float64) * made.image_peak
    probability = np.zeros_like(truth)
    cells = truth_cells(truth, made.noise_power, 6, RADAR.waveform.range_step_m)
    probability[tuple(cells.T)] = 0.5
    sure = known(probability, unit="probability of a target")
    assert average_precision(sure, made) == 1.0
    probability[43, 10] = 1.0  # where the truth has nothing
    assert score_frame(sure, made)["cells_false"].tolist() == [1.0]
    silent = replace(made, range_channel=np.zeros_like(made.range_channel))
    assert score_frame(sure, silent)["cells_false"].tolist() == []


def test_what_moves_is_found_in_its_own_doppler_cell_only():
    """The second peak holds a target at 1 m/s that the first, at 0, does not."""
    made = frame(3, RADAR)
    row, column = 12, 5
    images = np.full((3, 48, 20), 1e-9)
    images[1, row, column] = 1.0
    calls = iter(images)
    contender = answering(lambda *_: (next(calls)[None], None))
    mover = Target(row * RADAR.waveform.range_step_m, float(RADAR.grid.u[column]), 1.0, -100.0, "truck")
    wide = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"chirps": 512})})
    found = score_peaks(wide, contender, replace(made, targets=(mover,)), keep=False)["found"]
    assert found.tolist() == [[0, 0, 0], [1, 0, 1]]


def test_a_method_is_told_what_the_motion_says_of_each_doppler_peak(monkeypatch):
    made, worlds = frame(3, RADAR), []

    def image_and_score(_, rows, noise_power, world):
        worlds.append(world)
        return np.zeros((48, 20)), np.zeros((48, 20))

    monkeypatch.setattr(Known, "image_and_score", image_and_score)
    score_peaks(RADAR, known(np.zeros((48, 20))), made, keep=False)
    np.testing.assert_array_equal([world.velocity_mps for world in worlds], made.velocity)


def test_levels_keep_their_scale_as_bytes():
    image = np.outer(np.arange(1.0, 30.0), np.ones(4))
    levels = scene_levels(image, "sqrt(W)", 10.0 * image)
    assert levels.max() == pytest.approx(-20.0)
    assert np.abs(from_bytes(to_bytes(levels)) - levels).max() <= 0.5 * 60.0 / 255 + 1e-9
    assert scene_levels(image, "relative to the image's peak", 10.0 * image).max() == 0.0


def test_frames_shown_are_of_all_scenes_first():
    refs = [FrameRef(Path("p"), row, row, "scene", scene) for row, scene in enumerate("aaabbc")]
    assert [ref.frame_id for ref in one_of_each_scene(refs, 4)] == [0, 3, 5, 1]
