"""The direction-of-arrival network's samples and training."""

import numpy as np
import pytest
import torch
from tiny_radar import RADAR, TINY, frame, write_dataset

from shared.radar.arrays import line
from shared.signal.imaging import steering_weights
from trainer import fit, predict
from trainer.run.export import export
from trainer.run.folder import CHECKPOINT
from trainer.training.doa import AMPLITUDE_SPAN_DB, DoaSamples, DoaTask

DOA = TINY.model_copy(
    update={"model": "doa-cnn", "features": "covariance", "target": "doa", "width": 8, "rows": 16, "foreground": 0.0}
)
# Nine elements: the smallest array that four convolutions leave something of.
WIDE = RADAR.model_copy(update={"array": RADAR.array.model_copy(update={"rx_m": line(2e-3 * np.arange(9.0))})})


def test_samples_hold_one_to_three_targets_at_the_stated_levels():
    item = DoaSamples(RADAR, seed=1, size=8, rows=400)[3]
    truth, snapshot = item["truth"].numpy(), item["range_channel"][0].numpy()
    counts = truth.sum(axis=1)
    assert set(counts) == {1.0, 2.0, 3.0}
    # Amplitudes from 0 to 20 dB: a row's power is at most that of three in phase, plus noise at -3 dB or less.
    power_db = 10 * np.log10((np.abs(snapshot) ** 2).mean(axis=1))
    assert power_db[counts == 1].min() > -1.0
    assert power_db.max() < AMPLITUDE_SPAN_DB + 20 * np.log10(3) + 1.0
    # A single target stands where the truth says: delay-and-sum peaks there.
    weights = steering_weights(RADAR, np.arange(6))
    single = np.flatnonzero(counts == 1)
    peaks = np.abs(snapshot[single] @ weights).argmax(axis=1)
    assert np.mean(np.abs(peaks - truth[single].argmax(axis=1)) <= 1) > 0.8


def test_samples_are_a_function_of_seed_and_index():
    one, two = DoaSamples(RADAR, 1, 8, 5), DoaSamples(RADAR, 2, 8, 5)
    assert torch.equal(one[3]["range_channel"], one[3]["range_channel"])
    assert not torch.equal(one[3]["range_channel"], one[4]["range_channel"])
    assert not torch.equal(one[3]["range_channel"], two[3]["range_channel"])


def test_it_trains_resumes_predicts_and_exports(tmp_path, monkeypatch):
    frames = {"train": [frame(0, WIDE)], "validation": [frame(1, WIDE)], "test": [frame(2, WIDE)]}
    data = write_dataset(tmp_path / "data", frames, WIDE)
    lines: list[str] = []
    fit([data], tmp_path / "whole", config=DOA, array="full", announce=lines.append)
    original = DoaTask.training_step

    def killed(self, batch, batch_index):
        if batch_index == 3:
            raise MemoryError("killed")
        return original(self, batch, batch_index)

    monkeypatch.setattr(DoaTask, "training_step", killed)
    with pytest.raises(MemoryError):
        fit([data], tmp_path / "killed", config=DOA, array="full", announce=lines.append)
    monkeypatch.undo()
    fit([data], tmp_path / "killed", config=DOA, array="full", resume=True, announce=lines.append)
    states = [torch.load(tmp_path / name / CHECKPOINT, weights_only=True) for name in ("whole", "killed")]
    for key, tensor in states[0]["state_dict"].items():
        assert torch.equal(tensor, states[1]["state_dict"][key]), key
    assert predict([tmp_path / "whole", data], tmp_path / "images", announce=lines.append) == 1
    assert export(tmp_path / "whole", tmp_path / "doa.onnx").difference <= 1e-4
