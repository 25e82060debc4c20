"""A price list with more rays than usual: which are tried, and what does not fit is said before long work."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from datafactory.accuracy.knobs import POWER_KNOBS, QUICK_POWER_KNOBS, Knob, with_more_rays
from datafactory.cli.app import app
from datafactory.run import memory
from shared.processes import machine


def rays_of(knobs: tuple[Knob, ...]) -> tuple[int, ...]:
    (values,) = (knob.values for knob in knobs if knob.label == "rays")
    return values


def test_the_rays_go_on_in_doublings_to_the_most() -> None:
    assert rays_of(with_more_rays(POWER_KNOBS, 5_000_000)) == (*rays_of(POWER_KNOBS), 1_600_000, 3_200_000, 5_000_000)
    assert rays_of(with_more_rays(QUICK_POWER_KNOBS, 800_000)) == (*rays_of(QUICK_POWER_KNOBS), 400_000, 800_000)
    assert with_more_rays(POWER_KNOBS, 100_000) == POWER_KNOBS
    others = [knob for knob in with_more_rays(POWER_KNOBS, 5_000_000) if knob.label != "rays"]
    assert others == [knob for knob in POWER_KNOBS if knob.label != "rays"]


def test_what_does_not_fit_is_one_line_with_what_would(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "usable_memory", lambda: 8e9)
    out = tmp_path / "prices"
    arguments = ["accuracy", "--scene", "scenes/tiny.usda", "--out", str(out), "--most-rays", "50000000"]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code != 0
    said = f"{result.output} {result.exception}"
    assert "--most-rays" in said
    assert "191" in said  # GB: 1900 bytes of a ray with three bounces, twice 50 million of them
    fitting = int(said.rsplit("at most ", 1)[1].split()[0].rstrip(".)"))
    assert fitting == pytest.approx(8e9 / (2 * memory.RAY_BYTES[3]), rel=0.25)
    assert not out.exists()


@pytest.mark.parametrize(("more", "usual"), [([], 800_000), (["--quick"], 200_000)])
def test_rays_that_are_tried_anyway_are_not_more(tmp_path: Path, more: list[str], usual: int) -> None:
    out = tmp_path / "prices"
    arguments = ["accuracy", "--scene", "scenes/tiny.usda", "--out", str(out), "--most-rays", str(usual), *more]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code != 0
    assert f"{usual}, which are tried without it; expected more than {usual}" in f"{result.output} {result.exception}"
    assert not out.exists()
