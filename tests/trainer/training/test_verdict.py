"""The verdict: a perfect image scores 0 and 1, an empty one 1 and 0, and the numbers are those of the definition."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_evaluation import FULL, RADAR, THIN, strong_dataset, strong_frame
from tiny_radar import RADAR as NEAR_RADAR
from tiny_radar import TINY, small_dataset, write_dataset

from trainer import fit
from trainer.evaluation.experiments.contenders import estimator_contender
from trainer.evaluation.experiments.frames import score_frame
from trainer.metrics.bootstrap import Interval
from trainer.metrics.cells import CellScores, pooled, truth_cells
from trainer.run.answers import array_answer
from trainer.run.folder import METRICS, Run, load_imager, read_validations, save_weights, write_run
from trainer.run.imager import Imager
from trainer.training import verdict as module
from trainer.training.verdict import NAMES, PICTURE, VERDICT, VIEWS, Verdict, judge

WHOLE = {"model": "spectral-unet", "features": "adaptive"}
"""A network without a detection head, whose input has delay-and-sum as its third channel."""


def make_run(directory, gain=1.0, radar=RADAR, array=FULL, **changes):
    config = TINY.model_copy(update=WHOLE | changes)
    directory.mkdir()
    write_run(directory, Run(config=config, radar=radar, array=array, datasets=()))
    save_weights(directory, Imager(config, radar, array), gain)
    # Its second validation was the better one.
    (directory / METRICS).write_text("step,validation_loss,validation_gain\n0,0.2,\n4,0.1,\n")
    return directory


def loader(monkeypatch, network=None, detect=None):
    """load_imager, but with a network or an imager whose answer is known."""

    def load(directory):
        run, imager = load_imager(directory)
        imager.network = network or imager.network
        monkeypatch.setattr(imager, "detect", detect or imager.detect)
        return run, imager

    monkeypatch.setattr(module, "load_imager", load)


def answers(*images):
    """What an imager gives for one frame after the other: [R, U] images, or pairs of image and probability."""
    left = iter([image if isinstance(image, tuple) else (image, None) for image in images])

    def detect(_snapshot, _noise_power, _model_error_db, _prior, _place):
        return tuple(one if one is None else torch.from_numpy(one.astype(np.float32))[None] for one in next(left))

    return detect


def level(made):
    """[R, U] the truth of a frame [sqrt(W)]."""
    return made.image.astype(np.float64) * made.image_peak


class Das(torch.nn.Module):
    """Delay-and-sum itself, as an answer to the "row" target."""

    def forward(self, features):
        return features[:, 2:3].sqrt()


class Nothing(torch.nn.Module):
    def forward(self, features):
        return torch.zeros_like(features[:, :1])


def verdict_of(run, datasets):
    found = judge(run, datasets)
    assert found is not None
    return found


def test_a_perfect_imager_has_no_error_and_all_the_precision_and_an_empty_one_finds_nothing(tmp_path, monkeypatch):
    data, run = strong_dataset(tmp_path / "data"), make_run(tmp_path / "run")
    loader(monkeypatch, detect=answers(level(strong_frame(200))))
    found = verdict_of(run, [data])
    assert found.nmse["network"] < 1e-12
    assert found.average_precision["network"] > 0.98
    assert found.average_precision["truth"] > 0.98
    assert found.average_precision["das"] < 0.9
    loader(monkeypatch, Nothing())
    found = verdict_of(run, [data])
    assert found.nmse["network"] == 1.0
    assert found.average_precision["network"] == 0.0
    assert found.average_precision["truth"] > 0.98


def test_delay_and_sum_as_a_network_scores_as_delay_and_sum_and_its_gain_multiplies_it(tmp_path, monkeypatch):
    data, run = strong_dataset(tmp_path / "data", training=3), make_run(tmp_path / "run")
    loader(monkeypatch, Das())
    found = verdict_of(run, [data])
    assert found.frames == 1
    assert found.average_precision["network"] == pytest.approx(found.average_precision["das"], abs=1e-3)
    assert found.average_precision["das"] > 0.0
    assert found.nmse["network"] >= found.nmse["das"] > 0
    assert found.nmse["das"] < 1.0
    document = json.loads((run / VERDICT).read_text())
    assert document["nmse"] == found.nmse
    assert document["average_precision"] == found.average_precision
    assert (run / PICTURE).read_bytes()[:4] == b"\x89PNG"
    louder = verdict_of(make_run(tmp_path / "louder", gain=3.0), [data])
    assert louder.nmse["network"] > found.nmse["network"] + 1.0


def test_the_average_precision_is_that_of_evaluate(tmp_path):
    data, run = strong_dataset(tmp_path / "data"), make_run(tmp_path / "run")
    values = score_frame(estimator_contender("das", FULL, RADAR), strong_frame(200))
    cells = CellScores(values["cells_matched"], values["cells_false"], int(values["cells_true"]))
    expected = pooled([cells]).average_precision()
    assert verdict_of(run, [data]).average_precision["das"] == pytest.approx(expected, abs=1e-3)


def test_frames_without_a_truth_have_no_error_and_false_alarms_alone(tmp_path, monkeypatch):
    made, empty = strong_frame(2), replace(strong_frame(3), image=np.zeros((48, 20), np.float32), image_peak=0.0)
    splits = {"train": [strong_frame(0)], "validation": [strong_frame(1)], "test": [made, empty]}
    data, run = write_dataset(tmp_path / "data", splits, RADAR), make_run(tmp_path / "run")
    ghost = np.zeros((48, 20))
    ghost[40, 10] = 1.0
    loader(monkeypatch, detect=answers(level(made), ghost))
    found = verdict_of(run, [data])
    assert (found.frames, found.empty_frames) == (1, 1)
    assert found.nmse["network"] < 1e-12
    # The false alarm comes before all the truth cells.
    cells = truth_cells(level(made), made.noise_power, 6, RADAR.waveform.range_step_m)
    scores = level(made).astype(np.float32)[tuple(cells.T)].astype(np.float64)
    expected = pooled([CellScores(np.sort(scores)[::-1], np.ones(1), len(cells))]).average_precision()
    assert found.average_precision["network"] == pytest.approx(expected)
    assert expected < 0.9


def test_without_a_truth_to_test_there_is_no_verdict(tmp_path):
    lines: list[str] = []
    nothing = write_dataset(tmp_path / "none", {"train": [strong_frame(0)], "validation": [strong_frame(1)]}, RADAR)
    assert judge(make_run(tmp_path / "run"), [nothing], announce=lines.append) is None
    assert lines == ["no test frames with a truth: no verdict"]


def test_a_class_probability_has_no_amplitude_and_is_read_by_delay_and_sum(tmp_path, monkeypatch):
    """Sure of the truth cells, and surer of one bin where the data are strong and the truth is not."""
    made = strong_frame(200)
    image = made.image.copy()
    image[41:46] = 0.0
    made = replace(made, image=image)
    splits = {"train": [strong_frame(0)], "validation": [strong_frame(1)], "test": [made]}
    data, run = write_dataset(tmp_path / "data", splits, RADAR), make_run(tmp_path / "run", target="class")
    cells = truth_cells(level(made), made.noise_power, 6, RADAR.waveform.range_step_m)
    sure = np.zeros(image.shape)
    sure[tuple(cells.T)] = 0.5
    wrong = sure.copy()
    wrong[43, 10] = 1.0
    for probability, expected in ((sure, 1.0), (wrong, len(cells) / (len(cells) + 1))):
        loader(monkeypatch, detect=answers((probability, probability)))
        found = verdict_of(run, [data])
        assert found.nmse.keys() == {"das", *VIEWS}
        assert not found.nmse_over
        assert found.average_precision["network"] == pytest.approx(expected)
        assert found.average_precision.keys() == {"network", "untrained", "das", *VIEWS, "truth"}
        monkeypatch.undo()


def test_a_radar_that_ends_before_the_first_truth_cell_has_no_average_precision(tmp_path):
    data, run = small_dataset(tmp_path / "data", training=2), make_run(tmp_path / "run", radar=NEAR_RADAR)
    found = verdict_of(run, [data])
    assert found.average_precision == {}
    lines = found.table().splitlines()
    assert "average precision" in lines[0]
    assert [line.split()[-1] for line in lines[1:]] == ["-"] * (3 + len(VIEWS))
    assert len({len(line) for line in lines[1:]}) == 1


def test_fit_ends_with_the_verdict_of_its_best_weights(tmp_path):
    data = strong_dataset(tmp_path / "data", training=8)
    lines: list[str] = []
    fit([data], tmp_path / "run", config=TINY, array="full", announce=lines.append)
    assert lines[-2].startswith("test split, 1 frames")
    assert lines[-1] == "Whether training helped cannot be said of so few frames."
    document = json.loads((tmp_path / "run" / VERDICT).read_text())
    assert document["gain"] == pytest.approx(load_imager(tmp_path / "run")[1].gain)
    assert document["gain"] != 1.0
    again = verdict_of(tmp_path / "run", [data])
    assert again.nmse == document["nmse"]
    assert again.average_precision == document["average_precision"]


def test_the_run_it_began_with_is_scored_as_by_itself_and_the_differences_are_paired(tmp_path):
    data = strong_dataset(tmp_path / "data", tested=5)
    first, second = (make_run(tmp_path / str(seed), gain=1.0 + seed, seed=seed) for seed in (1, 2))
    alone = verdict_of(first, [data])
    found = judge(second, [data], str, start=first)
    assert found is not None
    for own, theirs in ((found.nmse, alone.nmse), (found.average_precision, alone.average_precision)):
        assert own["start"] == pytest.approx(theirs["network"], rel=1e-6)
        assert own["iaa-view"] == theirs["iaa-view"]
    others = {"das", *VIEWS, "start"}
    for own, over in ((found.nmse, found.nmse_over), (found.average_precision, found.average_precision_over)):
        assert over.keys() == others  # all channels are the network's here
        for name, interval in over.items():
            assert interval.value == pytest.approx(own["network"] - own[name], abs=1e-12)
            assert interval.low <= interval.value <= interval.high
    assert found.sentence().endswith("over the network it started from.")


def fit_of(data, out, rate):
    """The verdict that a fit from random weights ends with."""
    config = TINY.model_copy(update={"learning_rate": rate})
    fit([data], out, config=config, array="full", start=None)
    return json.loads((out / VERDICT).read_text())


def test_random_weights_are_scored_as_they_were_before_the_first_step(tmp_path):
    """Not the untrained view: the network's further iterations and its detections are there without training."""
    data = strong_dataset(tmp_path / "data", training=8, tested=6)
    untrained = fit_of(data, tmp_path / "run", 1e-15)
    assert [one.step for one in read_validations(tmp_path / "run")] == [0, 2, 4]
    assert untrained["step"] == 0
    for scores in (untrained["nmse"], untrained["average_precision"]):
        assert scores["untrained"] == scores["network"] != scores["iaa-view"]
    trained = fit_of(data, tmp_path / "other", 3e-3)
    assert trained["step"] == 4
    assert trained["nmse"]["untrained"] == untrained["nmse"]["network"]
    assert trained["nmse"]["network"] != untrained["nmse"]["network"]


def test_a_run_that_no_step_improved_says_so(tmp_path):
    data, run = strong_dataset(tmp_path / "data", tested=6), make_run(tmp_path / "run")
    assert "no step had a lower validation loss" not in verdict_of(run, [data]).sentence()
    (run / METRICS).write_text("step,validation_loss,validation_gain\n0,0.2,\n2,0.3,\n4,0.2,\n")
    said = (
        "Training did not help: no step had a lower validation loss than the weights before training, which are kept."
    )
    assert verdict_of(run, [data]).sentence() == said
    further = judge(run, [data], str, start=make_run(tmp_path / "start"))
    assert further is not None
    assert further.sentence() == said


def test_all_channels_are_asked_for_what_the_networks_channels_can_see(tmp_path):
    data, run = strong_dataset(tmp_path / "data", tested=2), make_run(tmp_path / "run", array=THIN)
    found = verdict_of(run, [data])
    full = array_answer(VIEWS[-1], FULL, RADAR)
    cells = [
        full.scored(level(made), made.range_channel[0], made.noise_power, None, len(THIN.rx))[1]
        for made in (strong_frame(200), strong_frame(201))
    ]
    assert found.average_precision["full"] == pytest.approx(pooled(cells).average_precision(), abs=1e-3)
    assert found.nmse["full"] < found.nmse[VIEWS[-1]]


BETTER, WORSE, NEITHER = Interval(0.1, 0.05, 0.2), Interval(-0.1, -0.2, -0.05), Interval(0.1, -0.1, 0.2)


@pytest.mark.parametrize(
    ("precision", "error", "said"),
    [
        (BETTER, WORSE, "Training helped: average precision +0.100 (+0.050 to +0.200), NMSE -0.100 (-0.200 to -0.050)"),
        (BETTER, NEITHER, "Training helped: "),
        (WORSE, NEITHER, "Training harmed: "),
        (BETTER, BETTER, "Training helped one and harmed the other: "),
        (NEITHER, NEITHER, "These frames do not show that training helped: "),
    ],
)
@pytest.mark.parametrize("start", ["start", "untrained"])
def test_the_sentence_follows_from_both_intervals_to_what_it_began_with(precision, error, said, start):
    scores = dict.fromkeys(("das", "iaa-view", start, "network"), 0.5)
    # Better than another method does not count.
    errors, precisions = (
        {"das": better, "iaa-view": better, start: one} for better, one in ((WORSE, error), (BETTER, precision))
    )
    sentence = Verdict(6, 0, 1.0, scores, scores, errors, precisions, 4).sentence()
    assert sentence.startswith(said)
    assert sentence.endswith(f"over the {NAMES[start]}.")
    few = Verdict(5, 0, 1.0, scores, scores, errors, precisions, 4)
    figures = f"average precision {precision.value:+.3f}, NMSE {error.value:+.3f}"
    assert (
        few.sentence() == f"Whether training helped cannot be said of so few frames: {figures} over the {NAMES[start]}."
    )
    assert " to " not in few.table()
