"""Scores of images whose score is known, and the frames that are shown; who is compared, and on what it was trained."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_evaluation import FULL, RADAR, THIN, make_run, run_all, strong_frame
from tiny_radar import frame

from shared.dataset import Target
from shared.physics.errors import InputError
from trainer.evaluation.experiments.bench import Bench, EvaluationConfig, FrameRef
from trainer.evaluation.experiments.contenders import estimator_contender, gather
from trainer.evaluation.experiments.doppler import score_peaks
from trainer.evaluation.experiments.frames import FrameScores, one_of_each_scene, score_frame, score_truth
from trainer.evaluation.experiments.generalisation import trained_on
from trainer.evaluation.report.page import from_bytes, scene_levels, to_bytes
from trainer.metrics.cells import truth_cells
from trainer.run.answers import Answer
from trainer.run.folder import Fingerprint, SceneRecord, Start, read_run, write_run


@dataclass(frozen=True, eq=False)
class Known(Answer):
    """Answers with what a function says."""

    function: Any

    def images(self, range_channel, told):
        return self.function(range_channel, told.noise_power)

    def das(self, range_channel):
        raise AssertionError("nothing that is scored here looks at delay and sum")


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


def test_levels_keep_their_scale_as_bytes():
    image = np.outer(np.arange(1.0, 30.0), np.ones(4))
    levels = scene_levels(image, "sqrt(W)", 10.0 * image)
    assert levels.max() == pytest.approx(-20.0)
    assert np.abs(from_bytes(to_bytes(levels)) - levels).max() <= 0.5 * 60.0 / 255 + 1e-9
    assert scene_levels(image, "relative to the image's peak", 10.0 * image).max() == 0.0


def test_frames_shown_are_of_all_scenes_first():
    refs = [FrameRef(Path("p"), row, row, "scene", scene) for row, scene in enumerate("aaabbc")]
    assert [ref.frame_id for ref in one_of_each_scene(refs, 4)] == [0, 3, 5, 1]


TWO_TX = RADAR.model_copy(
    update={"array": RADAR.array.model_copy(update={"tx_m": ((0.0, 0.0, 0.0), (0.0, 0.024, 0.0))})}
)
"""Twelve channels: what the network of angles needs at least is nine."""
DOA = {"model": "doa-cnn", "features": "covariance", "target": "doa"}


def test_the_table_says_on_what_a_network_was_trained(inputs, evaluation, tmp_path):
    def words(table):
        rows = [row for row in table.to_pylist() if row["experiment"] == "generalisation"]
        return {(row["method"], row["condition"].split(",d_max")[0]) for row in rows}

    assert {
        ("unet", "scene=hall,trained on it=yes"), ("unet", "scene=none,trained on it=no"),
        ("das", "scene=hall,trained on it=nothing"),
    } <= words(evaluation[0])  # fmt: skip
    other = make_run(tmp_path / "other", datasets=(Fingerprint(name="else", sha256="0" * 64, frames={}),))
    chosen = {"runs": [other], "methods": ["unet"], "experiments": ["generalisation"], "measured": None}
    assert ("unet", "scene=hall,trained on it=unknown") in words(run_all(inputs, tmp_path / "out", **chosen))


@pytest.mark.parametrize(
    ("met", "answer"),
    [
        ([], "no"),
        ([("street", "s"), ("canyon", "c")], "no"),
        ([("street", "s"), ("another name", "h")], "yes"),
        ([("hall", "h with cars")], "unknown"),
        (None, "unknown"),
    ],
)
def test_scenes_of_other_datasets_are_known_by_what_is_in_them(met, answer):
    scenes = None if met is None else tuple(SceneRecord(name=name, content_sha256=content) for name, content in met)
    other = Fingerprint(name="else", sha256="0" * 64, frames={}, scenes=scenes)
    network = replace(estimator_contender("das", FULL, RADAR), parameters=1, trained_on=(other,))
    hall = (SceneRecord(name="hall", content_sha256="h"),)
    bench = Bench("f" * 64, RADAR, (), frozenset(), (network,), EvaluationConfig(), scenes=hall)
    assert trained_on(bench, network, "hall") == answer
    assert trained_on(bench, network, "none") == "unknown"  # close targets are of no scene
    # What one of its datasets may have held, the network may have seen; what one held, it has.
    unknown = Fingerprint(name="older", sha256="1" * 64, frames={})
    both = replace(network, trained_on=(other, unknown))
    assert trained_on(bench, both, "hall") == ("yes" if answer == "yes" else "unknown")
    assert trained_on(replace(bench, scenes=None), network, "hall") == "unknown"


@pytest.mark.parametrize(
    ("scene", "answer"), [("hall", "yes"), ("canyon", "no"), ("tested alone", "no"), ("none", "yes")]
)
def test_of_the_first_frames_of_a_dataset_a_run_has_seen_some_scenes(scene, answer):
    records = tuple(SceneRecord(name=name, content_sha256=name) for name in ("hall", "canyon", "tested alone"))
    run = Fingerprint(name="data", sha256="f" * 64, frames={}, scenes=records[:1])
    network = replace(estimator_contender("das", FULL, RADAR), parameters=1, trained_on=(run,))
    training = frozenset({"hall", "canyon", "none"})
    bench = Bench("f" * 64, RADAR, (), training, (network,), EvaluationConfig(), scenes=records)
    assert trained_on(bench, network, scene) == answer


def test_a_network_has_seen_what_the_run_that_it_began_with_has(tmp_path):
    met = tuple(Fingerprint(name=name, sha256=64 * name[0], frames={"train": 4}) for name in ("a", "b", "c"))
    first = make_run(tmp_path / "first", FULL, datasets=met[:1])
    second = make_run(tmp_path / "second", FULL, datasets=met[1:2])
    write_run(second, read_run(second).model_copy(update={"start": Start.of(first)}))
    third = make_run(tmp_path / "third", FULL, datasets=met[2:])
    write_run(third, read_run(third).model_copy(update={"start": Start.of(second)}))
    (network,) = gather(["unet"], [third], [FULL], RADAR, tmp_path)
    assert network.trained_on == met


def test_a_network_of_angles_takes_rows_alone_and_was_trained_on_no_scene(tmp_path):
    seen = (Fingerprint(name="data", sha256="0" * 64, frames={}),)
    run = make_run(tmp_path / "run", FULL, TWO_TX, seen, **DOA)
    (cnn,) = gather(["cnn"], [run], [FULL], TWO_TX, tmp_path)
    assert (cnn.name, cnn.answer.unit, cnn.trained_on) == ("cnn full", "probability of a target", ())
    generator = np.random.default_rng(1)
    snapshots = (generator.standard_normal((48, 12, 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)
    image = cnn.answer.image(snapshots, 1e-3)
    assert image.shape == (48, 20)
    assert 0.0 < image.min() < image.max() < 1.0
    rows = np.array([4, 40])
    np.testing.assert_allclose(cnn.answer.image_rows(snapshots, 1e-3, rows), image[rows], rtol=1e-5)


def test_contenders_stand_in_the_order_of_methods_and_arrays_whatever_that_of_the_runs(tmp_path):
    arrays = {"c": (THIN, {}), "b": (FULL, DOA), "a": (FULL, {})}
    runs = [make_run(tmp_path / name, array, TWO_TX, **changes) for name, (array, changes) in arrays.items()]
    names = [contender.name for contender in gather(["cnn", "das", "unet"], runs, [FULL, THIN], TWO_TX, tmp_path)]
    assert names == ["das full", "das thin", "cnn full", "unet full", "unet thin"]


def test_two_networks_of_one_kind_are_told_apart(inputs, tmp_path):
    runs = [make_run(tmp_path / name) for name in ("wide", "deep")]
    table = run_all(
        inputs, tmp_path / "out", runs=runs, methods=["unet"], experiments=["tradeoff"], measured=None,
    )  # fmt: skip
    assert set(table["method"].to_pylist()) == {"unet:wide", "unet:deep"}
    copy = tmp_path / "else" / "wide"
    copy.parent.mkdir()
    with pytest.raises(InputError, match="two runs are named 'unet:wide thin'"):
        run_all(inputs, tmp_path / "no", runs=[runs[0], make_run(copy)], methods=["unet"], measured=None)
