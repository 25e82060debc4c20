"""The ablation's scores, and its table from variants trained anew."""

import numpy as np
import pytest
import torch
from small_evaluation import FULL, RADAR, strong_dataset
from tiny_radar import TINY, frame

from shared.physics.errors import InputError
from trainer.data.pairs import simulate
from trainer.run.folder import load_imager
from trainer.run.imager import Imager
from trainer.training import ablation
from trainer.training.ablation import PAIRS, behind, best_validation, giga_flops, score_run, table


def test_the_validation_error_is_that_of_the_weights_kept(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,validation_loss,validation_nmse\n1,0.5,0.9\n2,0.2,0.7\n3,0.3,0.6\n")
    assert best_validation(tmp_path) == 0.7


def test_operations_grow_with_the_image():
    imager = Imager(TINY, RADAR, FULL)
    assert giga_flops(imager, 48) == pytest.approx(2 * giga_flops(imager, 24), rel=1e-6)


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Two variants of two steps, and a dataset."""
    monkeypatch.setattr(ablation, "TRIALS", 2)
    size = {"width": 4, "hidden": 8, "batch": 2, "rows": 0}
    monkeypatch.setattr(ablation, "VARIANTS", {"one": size, "two": {**size, "exponent": 1.0}})
    return strong_dataset(tmp_path / "data")


def test_the_table_has_a_line_for_each_variant(tmp_path, monkeypatch, small):
    given = [small], tmp_path, ["one", "two"], 2, "32", ["full"]
    text = table(*given)
    assert [line.split(" | ")[0] for line in text.splitlines()[2:4]] == ["| one", "| two"]
    assert (tmp_path / "ablation.md").read_text() == text
    head = [cell.strip() for cell in text.splitlines()[0].strip("|").split("|")]
    assert head[4:] == [
        "validation NMSE", "validation AP", "resolved 0.5 RL at 20 dB", "resolved 0.25 RL at 30 dB",
        "test NMSE", "test AP",
    ]  # fmt: skip
    assert all(line.count("|") == len(head) + 1 for line in text.splitlines())
    assert text.splitlines()[-2].split(" | ")[-2:] == ["1.000", " |"]
    assert text.splitlines()[-1].split(" | ")[-2:] == ["", "1.000 |"]  # the truth: the most that is possible
    network, das = (line.strip(" |").split(" | ") for line in text.splitlines()[2:5:2])
    assert np.isfinite([float(cell) for cell in network[4:]]).all()
    # The score beside the metrics of the run is that of the same frames, weights and gain.
    run = tmp_path / "one-full-0"
    scored = score_run(*load_imager(run), [small])
    assert scored.nmse == pytest.approx(best_validation(run), rel=1e-3)
    assert network[4] == f"{best_validation(run):.3f}"
    assert network[5:8] == [f"{value:.3f}" for value in (scored.average_precision, *scored.resolved)]
    assert 0.0 < float(das[-1]) <= 1.0
    # A variant that is there is scored again, not trained again.
    monkeypatch.setattr(ablation, "fit", None)
    assert table(*given) == text
    with pytest.raises(InputError, match="--variants: 'three'; expected some of one, two"):
        table([small], tmp_path, ["three"], 2, "32")


def test_pairs_are_resolved_by_the_score_where_a_network_has_one(tmp_path, monkeypatch, small):
    """The image shows one target in the middle, the probability has both."""
    table([small], tmp_path, ["one"], 2, "32", ["full"])
    run, imager = load_imager(tmp_path / "one-full-0")
    pairs = [simulate(RADAR, pair, 2, [1, 20]) for pair in PAIRS]
    given = [trials.snapshots[0] for trials in pairs]

    def detect(snapshot, noise_power, _model_error_db):
        image = torch.full((1, 48, 20), 1e-3)
        image[:, :, 10] = 1e-2
        probability = torch.full((1, 48, 20), 1e-6)
        for trials, known in zip(pairs, given, strict=True):
            if np.array_equal(snapshot[0].numpy(), known):
                for row, angles in zip(trials.rows, trials.u, strict=True):
                    probability[0, row, [int(np.abs(RADAR.grid.u - u).argmin()) for u in angles]] = 1.0
        return image, probability

    monkeypatch.setattr(imager, "detect", detect)
    with_score = score_run(run, imager, [small]).resolved
    monkeypatch.setattr(imager, "detect", lambda *given: (detect(*given)[0], None))
    assert max(score_run(run, imager, [small]).resolved) == 0.0
    assert with_score[0] == 1.0


def test_seeds_are_one_line_and_other_arrays_a_second_table(tmp_path, small):
    (tmp_path / "half.toml").write_text("rx = [0, 1, 2, 5]\n")
    array = str(tmp_path / "half.toml")
    text = table([small], tmp_path / "out", ["one"], 2, "32", ["full", array], [0, 1])
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir()) == [
        "one-full-0", "one-full-1", "one-half-0", "one-half-1",
    ]  # fmt: skip
    first, second = text.split("\n\n")
    assert first.splitlines()[2].count("±") == 6
    assert [line.split(" | ")[:3] for line in second.splitlines()[2:]] == [
        ["| one", "full", "half"], ["| one", "half", "full"],
    ]  # fmt: skip


def test_weights_move_behind_another_array(tmp_path, small):
    """The same weights, of other channels: the image of the array it was trained with is not that of the other."""
    table([small], tmp_path, ["one"], 2, "32", ["full"])
    (tmp_path / "half.toml").write_text("rx = [0, 1, 2, 5]\n")
    run = tmp_path / "one-full-0"
    made = frame(7, RADAR)
    snapshot, noise = torch.from_numpy(made.range_channel[:1]), torch.tensor([made.noise_power])
    with torch.no_grad():
        trained = load_imager(run)[1](snapshot, noise)
        same, other = (behind(run, name)(snapshot, noise) for name in ("full", str(tmp_path / "half.toml")))
    torch.testing.assert_close(same, trained, rtol=1e-4, atol=1e-14)
    assert not torch.allclose(other, trained, rtol=1e-2, atol=1e-14)


def test_seeds_that_are_none_are_refused(capsys):
    with pytest.raises(SystemExit, match="--seeds: 'one'; expected whole numbers"):
        ablation.main(["data", "--out", "out", "--seeds", "one"])
