"""``trainer export``: what onnxruntime answers is what torch answers, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from tiny_radar import NOISE_POWER, RADAR, frame
from tiny_run import make_run

from shared.signal.adaptive import adaptive_tables
from shared.signal.features import adaptive_features, row_features, snapshot_features
from shared.signal.imaging import steering_weights
from trainer.errors import Stopped
from trainer.networks import real_unrolled
from trainer.run.export import export
from trainer.run.folder import load_imager

SPECTRAL = {"model": "spectral-unet"}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"model": "attention-unet", "features": "paper", "target": "paper"},
        {"target": "class"},
    ],
    ids=["adaptive", "paper", "class"],
)
def test_onnx_gives_what_torch_gives(tmp_path, changes):
    run = make_run(tmp_path / "run", **{**SPECTRAL, **changes})
    result = export(run, tmp_path / "network.onnx")
    assert result.difference <= 1e-4
    assert min(result.torch_seconds, result.onnx_seconds) > 0
    session = onnxruntime.InferenceSession(str(result.path), providers=["CPUExecutionProvider"])
    description = json.loads(session.get_modelmeta().custom_metadata_map["sparseradar"])
    assert description["chosen_array"]["rx"] == [0, 1, 2, 5]
    assert description["axes"]["u"]["bins"] == 20
    imager = load_imager(run)[1]
    snapshot = frame(5).range_channel[:1]
    noise = np.array([NOISE_POWER])
    features = imager.features(torch.from_numpy(snapshot), torch.from_numpy(noise))[0].numpy()
    assert len(description["features"]) == features.shape[1]
    if imager.config.features != "paper":  # the deployed front end: NumPy alone
        channels = np.array([0, 1, 2, 5])
        given = snapshot[..., channels], steering_weights(RADAR, channels), noise
        own = row_features(*given)[0]
        np.testing.assert_allclose(own, features[:, :4], atol=1e-5)
        config = description["config"]
        tables = adaptive_tables(RADAR, channels)
        own = adaptive_features(*given, tables, config["iterations"], config["exponent"])[0]
        # Five inverses in single precision, then a square root.
        np.testing.assert_allclose(own, features, atol=5e-3)
    found = session.run(None, {"features": features})[0]
    with torch.no_grad():
        expected = imager.network(torch.from_numpy(features)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_unrolled_network_is_exported_in_real_arithmetic(tmp_path):
    run = make_run(tmp_path / "run")
    result = export(run, tmp_path / "network.onnx")
    assert result.difference <= 1e-4
    session = onnxruntime.InferenceSession(str(result.path), providers=["CPUExecutionProvider"])
    imager = load_imager(run)[1]
    assert imager.config.model == "unrolled"
    snapshot = frame(5).range_channel[:1, :20]  # any number of range bins
    channels = np.array([0, 1, 2, 5])
    features, _ = snapshot_features(snapshot[..., channels], np.array([NOISE_POWER]))  # NumPy alone
    found = session.run(None, {"features": features})[0]
    with torch.no_grad():
        expected = imager.network(torch.from_numpy(features)).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_a_graph_that_is_wrong_for_echoes_alone_is_not_written(tmp_path, monkeypatch):
    """More noise than there is beside strong echoes: rows of noise answer as they should."""
    monkeypatch.setattr(real_unrolled, "FLOOR", 1e-2)
    with pytest.raises(Stopped, match=r"onnx: on targets at \d0 dB onnxruntime errs by .* torch by .*e-0[5-7], from"):
        export(make_run(tmp_path / "run"), tmp_path / "network.onnx")
    assert not (tmp_path / "network.onnx").exists()


@pytest.mark.parametrize("name", ["sparse6", "sparse4"])
def test_the_package_s_networks_round_as_torch_does(tmp_path, name):
    result = export(Path(name), tmp_path / "network.onnx")
    assert 1e-4 < result.difference < 3e-2
    assert 0.2 < result.difference / result.rounding < 5.0
