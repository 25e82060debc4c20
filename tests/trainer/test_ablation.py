"""The ablation's scores, and its table from variants trained anew."""

import numpy as np
import pytest
from tiny_radar import RADAR, TINY, small_dataset

from shared.errors import InputError
from trainer.arrays import ArrayChoice
from trainer.experiments import ablation
from trainer.experiments.ablation import best_validation, giga_flops, table
from trainer.imager import Imager

FULL = ArrayChoice(name="full", rx=tuple(range(6)))


def test_the_validation_error_is_that_of_the_weights_kept(tmp_path):
    (tmp_path / "metrics.csv").write_text("step,validation_loss,validation_nmse\n1,0.5,0.9\n2,0.2,0.7\n3,0.3,0.6\n")
    assert best_validation(tmp_path) == 0.6


def test_operations_grow_with_the_image():
    imager = Imager(TINY, RADAR, FULL)
    assert giga_flops(imager, 48) == pytest.approx(2 * giga_flops(imager, 24), rel=1e-6)


def test_the_table_has_a_line_for_each_variant(tmp_path, monkeypatch):
    data = small_dataset(tmp_path / "data", training=2)
    monkeypatch.setattr(ablation, "fit", lambda *given, resume: FIT(*given, array="full", resume=resume))
    small = {"width": 4, "hidden": 8, "batch": 2, "rows": 0}
    monkeypatch.setattr(ablation, "VARIANTS", {"one": small, "two": {**small, "exponent": 1.0}})
    text = table([data], tmp_path, ["one", "two"], steps=2, precision="32")
    assert [line.split(" | ")[0] for line in text.splitlines()[2:4]] == ["| one", "| two"]
    assert (tmp_path / "ablation.md").read_text() == text
    assert text.splitlines()[-1].split(" | ")[4] == "1.000"
    network, das = (line.strip(" |").split(" | ") for line in text.splitlines()[2:5:2])
    assert np.isfinite([float(cell) for cell in network[3:]]).all()
    assert 0.0 < float(das[-1]) <= 1.0
    # A variant that is there is scored again, not trained again.
    monkeypatch.setattr(ablation, "fit", None)
    assert table([data], tmp_path, ["one", "two"], steps=2, precision="32") == text
    with pytest.raises(InputError, match="--variants: 'three'; expected some of one, two"):
        table([data], tmp_path, ["three"], steps=2, precision="32")


FIT = ablation.fit
