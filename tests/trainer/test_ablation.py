"""The ablation's scores, and its table from variants trained anew."""

import numpy as np
import pytest
import torch
from tiny_radar import RADAR, TINY, small_dataset

from shared.errors import InputError
from trainer.arrays import ArrayChoice
from trainer.experiments import ablation
from trainer.experiments.ablation import giga_flops, score, table
from trainer.imager import Imager

FULL = ArrayChoice(name="full", rx=tuple(range(6)))


def test_the_truth_itself_scores_zero_and_an_empty_image_one(tmp_path):
    data = small_dataset(tmp_path / "data", training=2)
    imager = Imager(TINY, RADAR, FULL).eval()

    class Nothing(torch.nn.Module):
        def forward(self, features):
            return torch.zeros_like(features[:, :1])

    imager.network = Nothing()
    found = score(imager, data)
    assert found.error == 1.0
    assert found.scaled_error == 1.0
    assert 0.0 < found.das_error < 1.0
    assert 0.0 < found.mean_error < 1.0

    class Das(torch.nn.Module):
        def forward(self, features):
            return features[:, 2:3].sqrt()

    imager.network = Das()
    again = score(imager, data)
    assert again.scaled_error == pytest.approx(found.das_error, rel=1e-4)
    assert again.error >= again.scaled_error


def test_operations_grow_with_the_image():
    imager = Imager(TINY, RADAR, FULL)
    assert giga_flops(imager, 48) == pytest.approx(2 * giga_flops(imager, 24), rel=1e-6)


def test_the_table_has_a_line_for_each_variant(tmp_path, monkeypatch):
    data = small_dataset(tmp_path / "data", training=2)
    monkeypatch.setattr(ablation, "fit", lambda datasets, out, config: FIT(datasets, out, config, array="full"))
    small = {"width": 4, "hidden": 8, "batch": 2}
    monkeypatch.setattr(ablation, "VARIANTS", {"one": small, "two": {**small, "exponent": 1.0}})
    text = table([data], tmp_path, ["one", "two"], steps=2, precision="32")
    assert [line.split(" | ")[0] for line in text.splitlines()[2:4]] == ["| one", "| two"]
    assert (tmp_path / "ablation.md").read_text() == text
    assert np.isfinite([float(cell) for cell in text.splitlines()[2].split(" | ")[3].strip(" |").split(" / ")]).all()
    # A variant that is there is scored again, not trained again.
    monkeypatch.setattr(ablation, "fit", None)
    assert table([data], tmp_path, ["one", "two"], steps=2, precision="32") == text
    with pytest.raises(InputError, match="--variants: 'three'; expected some of one, two"):
        table([data], tmp_path, ["three"], steps=2, precision="32")


FIT = ablation.fit
