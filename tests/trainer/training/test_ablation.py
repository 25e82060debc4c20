"""The ablation's scores, and its table from variants trained anew."""

import numpy as np
import pytest
import torch
from tiny_radar import RADAR, TINY, frame, small_dataset

from shared.physics.errors import InputError
from trainer.data.arrays import ArrayChoice
from trainer.run.folder import load_imager
from trainer.run.imager import Imager
from trainer.training import ablation
from trainer.training.ablation import behind, best_validation, giga_flops, table

FULL = ArrayChoice(name="full", rx=tuple(range(6)))


def test_the_validation_error_is_that_of_the_weights_kept(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,validation_loss,validation_nmse\n1,0.5,0.9\n2,0.2,0.7\n3,0.3,0.6\n")
    assert best_validation(tmp_path) == 0.6


def test_operations_grow_with_the_image():
    imager = Imager(TINY, RADAR, FULL)
    assert giga_flops(imager, 48) == pytest.approx(2 * giga_flops(imager, 24), rel=1e-6)


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Two variants of two steps, and a dataset."""
    monkeypatch.setattr(ablation, "TRIALS", 2)
    size = {"width": 4, "hidden": 8, "batch": 2, "rows": 0}
    monkeypatch.setattr(ablation, "VARIANTS", {"one": size, "two": {**size, "exponent": 1.0}})
    return small_dataset(tmp_path / "data", training=2)


def test_the_table_has_a_line_for_each_variant(tmp_path, monkeypatch, small):
    given = [small], tmp_path, ["one", "two"], 2, "32", ["full"]
    text = table(*given)
    assert [line.split(" | ")[0] for line in text.splitlines()[2:4]] == ["| one", "| two"]
    assert (tmp_path / "ablation.md").read_text() == text
    assert text.splitlines()[-1].split(" | ")[-2:] == ["1.000", " |"]
    network, das = (line.strip(" |").split(" | ") for line in text.splitlines()[2:5:2])
    assert np.isfinite([float(cell) for cell in network[4:]]).all()
    # The score beside the metrics of the run is that of the same frames, weights and gain.
    assert float(network[4]) == pytest.approx(best_validation(tmp_path / "one-full-0"), abs=5e-4)
    assert 0.0 < float(das[-1]) <= 1.0
    # A variant that is there is scored again, not trained again.
    monkeypatch.setattr(ablation, "fit", None)
    assert table(*given) == text
    with pytest.raises(InputError, match="--variants: 'three'; expected some of one, two"):
        table([small], tmp_path, ["three"], 2, "32")


def test_seeds_are_one_line_and_other_arrays_a_second_table(tmp_path, small):
    (tmp_path / "half.toml").write_text("rx = [0, 1, 2, 5]\n")
    array = str(tmp_path / "half.toml")
    text = table([small], tmp_path / "out", ["one"], 2, "32", ["full", array], [0, 1])
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir()) == [
        "one-full-0", "one-full-1", "one-half-0", "one-half-1",
    ]  # fmt: skip
    first, second = text.split("\n\n")
    assert first.splitlines()[2].count("±") == 5
    assert [line.split(" | ")[:3] for line in second.splitlines()[2:]] == [
        ["| one", "full", "half"], ["| one", "half", "full"],
    ]  # fmt: skip


def test_weights_move_behind_another_array(tmp_path, small):
    """The same weights, of other channels: the image of the array it was trained with is not that of the other."""
    table([small], tmp_path, ["one"], 2, "32", ["full"])
    (tmp_path / "half.toml").write_text("rx = [0, 1, 2, 5]\n")
    run = tmp_path / "one-full-0"
    made = frame(7)
    snapshot, noise = torch.from_numpy(made.range_channel[:1]), torch.tensor([made.noise_power])
    with torch.no_grad():
        trained = load_imager(run)[1](snapshot, noise)
        same, other = (behind(run, name)(snapshot, noise) for name in ("full", str(tmp_path / "half.toml")))
    torch.testing.assert_close(same, trained, rtol=1e-4, atol=1e-14)
    assert not torch.allclose(other, trained, rtol=1e-2, atol=1e-14)


def test_seeds_that_are_none_are_refused(capsys):
    with pytest.raises(SystemExit, match="--seeds: 'one'; expected whole numbers"):
        ablation.main(["data", "--out", "out", "--seeds", "one"])
