"""A network trained in bfloat16 is computed in float32 where the processor has no instructions for it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from small_evaluation import QUICK, strong_dataset
from small_fit import run as small_fit
from tiny_radar import TINY, frame, tiny
from tiny_run import make_run

from trainer import evaluate, predict
from trainer.run.folder import load_imager
from trainer.run.imager import FLOAT32_INSTEAD, in_bfloat16, precision_remark

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
