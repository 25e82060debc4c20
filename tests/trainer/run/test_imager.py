"""A run's network: computed in what the processor has, exported to ONNX; those of the package by their card."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from small_evaluation import QUICK, strong_dataset
from tiny_radar import NOISE_POWER, RADAR, TINY, frame, tiny
from tiny_run import make_run
from tiny_run import run as small_fit

from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal.adaptive import adaptive_tables
from shared.signal.features import adaptive_features, row_features, snapshot_features
from shared.signal.imaging import steering_weights
from shared.signal.windows import cell_noise_power
from trainer import evaluate, predict
from trainer.data.simulation import TrialCondition, simulate
from trainer.errors import Stopped
from trainer.estimators.array import line_array
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.metrics.peaks import resolved
from trainer.networks import real_unrolled
from trainer.run.export import export
from trainer.run.folder import load_imager
from trainer.run.imager import FLOAT32_INSTEAD, in_bfloat16, precision_remark
from trainer.run.pretrained import pretrained_names, pretrained_run

WITHOUT: dict[str, bool] = {}
WITH = [{name: True} for name in ("avx512_bf16", "amx_bf16", "bf16", "sve_bf16")]


@pytest.mark.parametrize("capabilities", [WITHOUT, *WITH])
@pytest.mark.parametrize("precision", ["32", "bf16"])
def test_a_network_is_computed_in_what_the_processor_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capabilities: dict[str, bool], precision: str
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    _, imager = load_imager(make_run(tmp_path / "run", model="spectral-unet", precision=precision))
    seen: list[bool] = []
    imager.network.register_forward_pre_hook(lambda *_: seen.append(torch.is_autocast_enabled("cpu")))
    with torch.inference_mode():
        imager(torch.from_numpy(frame(0).range_channel), torch.ones(3))
    assert seen == [precision == "bf16" and bool(capabilities)]


def test_a_gpu_is_not_asked_for_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: WITHOUT)
    assert in_bfloat16(tiny(precision="bf16"), "cuda")
    assert not in_bfloat16(tiny(precision="32"), "cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert precision_remark([tiny(precision="bf16")]) is None


@pytest.mark.parametrize(("capabilities", "times"), [(WITHOUT, 1), (WITH[0], 0)])
def test_fit_predict_and_evaluate_say_so_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capabilities: dict[str, bool], times: int
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    data = strong_dataset(tmp_path / "data")
    config = TINY.model_copy(update={"precision": "bf16"})
    _, of_fit = small_fit(data, tmp_path / "run", config)
    of_predict: list[str] = []
    predict([tmp_path / "run", data], tmp_path / "out", pictures=False, announce=of_predict.append)
    of_evaluate: list[str] = []
    evaluate(
        data, out=tmp_path / "report", **QUICK, run=[tmp_path / "run"], methods=["unet"], arrays=["full"],
        announce=of_evaluate.append,
    )  # fmt: skip
    for lines in (of_fit, of_predict, of_evaluate):
        assert "\n".join(lines).count(FLOAT32_INSTEAD) == times


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
    with pytest.raises(InputError, match=r"range_channel: shape \[.*, 4\]; expected \[frames, range bins, 6\]"):
        imager(torch.from_numpy(snapshot[..., :4]), torch.from_numpy(noise))
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


MOST_BYTES = 8_000_000
"""A wheel that carries them is still fetched in a second."""
NAMES = ("sparse4", "sparse6")


def test_they_are_there_with_their_card_and_small():
    assert pretrained_names() == NAMES
    folder = pretrained_run("sparse6").parent
    assert (folder / "README.md").is_file()
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < MOST_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_it_is_of_the_default_radar_and_its_array(name):
    run, imager = load_imager(pretrained_run(name))
    assert run.radar == load_radar("avr-qdm-110")
    assert run.array.name == name
    assert imager.detects


@pytest.mark.parametrize("name", NAMES)
def test_one_target_reads_its_level_at_its_place_and_is_certain(name):
    run, imager = load_imager(pretrained_run(name))
    radar, noise = run.radar, cell_noise_power(run.radar)
    trials = simulate(radar, TrialCondition(0.0, 25.0), 20, [4])
    with torch.inference_mode():
        image, probability = imager.detect(torch.from_numpy(trials.snapshots[:1]), torch.tensor([noise]))
    assert probability is not None
    rows = np.arange(len(trials.rows))
    place = np.rint((trials.u[rows, 0] - radar.grid.u[0]) / radar.grid.step).astype(int)
    seen = image[0, trials.rows].numpy()
    assert np.median(np.abs(seen.argmax(axis=1) - place)) <= 1
    level_db = 20.0 * np.log10(seen.max(axis=1) / np.sqrt(noise)) - 25.0
    assert abs(np.median(level_db)) < 1.0
    certain = probability[0, trials.rows].numpy()
    near = np.stack([certain[row, max(p - 2, 0) : p + 3].max() for row, p in zip(rows, place, strict=True)])
    assert np.median(near) > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_its_lines_resolve_pairs_half_a_cell_apart(name):
    """At 20 dB maximum likelihood that is told there are two resolves 0.96 and more of them."""
    run, imager = load_imager(pretrained_run(name))
    radar, noise = run.radar, cell_noise_power(run.radar)
    channels = run.array.channels(radar)
    trials = simulate(radar, TrialCondition(0.5, 20.0), 46, [5])
    found = []
    for snapshots in trials.snapshots:
        with torch.inference_mode():
            image, probability = imager.detect(torch.from_numpy(snapshots)[None], torch.tensor([noise]))
        assert probability is not None
        score = (image * probability.sqrt())[0, trials.rows].numpy()
        line = line_array(radar, channels)
        lines = fit_lines(snapshots[trials.rows][:, channels], line, noise, score_peaks(score, radar.grid.u, 6))
        found.append(np.sort(lines.u[:, :2], axis=1))
    assert resolved(np.concatenate(found), trials.u).mean() > 0.9
