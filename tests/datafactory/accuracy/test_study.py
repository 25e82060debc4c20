"""The price list: errors fall where accuracy is bought, all is priced, and the front is what a budget would choose."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from typer.testing import CliRunner

from datafactory.accuracy import chart, study
from datafactory.accuracy.knobs import DEFAULT, POWER_KNOBS, QUICK, STUDY
from datafactory.accuracy.looking import STAGES, Clock
from datafactory.accuracy.power import FLOOR_DB
from datafactory.accuracy.study import DEFAULTS, FRONT, Row
from datafactory.cli.app import app
from datafactory.run import memory

ROW = Row(
    knob=DEFAULTS, setting="all", default=True, seconds=6.0, stage_seconds=dict.fromkeys(STAGES, 1.0),
    paths=1000.0, work=1.0, cube_error_db=-45.0, image_error_db=-80.0, power_error_db=-40.0, power_bias_db=None,
)  # fmt: skip
"""The default's row, after which others are shaped."""


def level(rows: list[Row], knob: str, value: object, error: str) -> float:
    (row,) = (row for row in rows if (row.knob, row.setting) == (knob, str(value)))
    return getattr(row, f"{error}_error_db")


def test_tighter_settings_have_smaller_errors(prices) -> None:
    tolerances = (1e-3, 1e-6, 1e-9)
    cube = [level(prices.rows, "tolerance", value, "cube") for value in tolerances]
    assert cube[0] > cube[1] > cube[2]
    assert all(error <= 20.0 * np.log10(promise) for error, promise in zip(cube, tolerances, strict=True))
    for knob, coarse, fine, error in (
        ("prune_db", -20.0, -40.0, "cube"),
        ("prune_db", -20.0, -40.0, "image"),
        ("truth_terms", 3, 5, "image"),
        ("rays", 500, 4000, "power"),
        ("depth", 1, 2, "power"),
    ):
        assert level(prices.rows, knob, coarse, error) > level(prices.rows, knob, fine, error)


def test_every_row_is_priced(prices) -> None:
    assert prices.rows[0].knob == DEFAULTS
    for row in prices.rows:
        assert tuple(row.stage_seconds) == STAGES
        assert row.seconds == pytest.approx(sum(row.stage_seconds.values()))
        assert FLOOR_DB <= row.worst_db < 60.0
        assert min(row.seconds, row.work, row.paths) > 0.0
        together = row.knob in (DEFAULTS, FRONT)
        assert (row.power_error_db is None) == (not together and row.knob not in POWER_KNOBS)
        assert (row.cube_error_db is None) == (row.image_error_db is None) == (row.knob in POWER_KNOBS)
        assert (row.power_bias_db is None) == together
    assert [row.setting for row in prices.rows if row.default and row.knob == "tolerance"] == ["0.001"]


def test_the_front_keeps_what_it_promises(prices) -> None:
    front = [row for row in prices.rows if row.knob == FRONT]
    levels = [float(row.setting.split(" dB")[0]) for row in front]
    assert len(levels) > 1
    assert all(a > b for a, b in pairwise(levels))
    for row, promised in zip(front, levels, strict=True):
        # What was predicted from single knobs is what all of them have together, to a decibel or two.
        assert row.worst_db <= promised + 2.0


def test_tables_and_picture_are_those_of_the_rows(prices) -> None:
    read = pq.read_table(prices.folder / "accuracy.parquet").to_pylist()
    assert read == [asdict(row) for row in prices.rows]
    with (prices.folder / "accuracy.csv").open(encoding="utf-8", newline="") as handle:
        lines = list(csv.DictReader(handle))
    assert [line["cube_error_db"] for line in lines] == [str(row["cube_error_db"] or "") for row in read]
    assert [json.loads(line["stage_seconds"]) for line in lines] == [row.stage_seconds for row in prices.rows]
    assert (prices.folder / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    for heading in ("s/frame", "cube dB", "bias dB", "work s"):
        assert heading in prices.said


@pytest.mark.parametrize("step_db", [1.0, 3.0])
def test_rays_of_points_close_together_stand_apart(step_db: float) -> None:
    front = [
        Row(**{**asdict(ROW), "knob": FRONT, "setting": f"-9 dB: {rays} rays, depth 1", "power_error_db": -80.0,
               "cube_error_db": -15.0 - step_db * place, "seconds": 1.0 + 0.04 * place})
        for place, rays in enumerate((3125, 6250, 12_500))
    ]  # fmt: skip
    dear = Row(
        **{**asdict(front[0]), "setting": "-9 dB: 800000 rays, depth 1", "cube_error_db": -45.0, "seconds": 40.0}
    )
    figure = chart.draw([ROW, *front, dear], "tiny")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    labels = [text for text in figure.axes[0].texts if text.get_text().endswith(" rays")]
    boxes = [label.get_window_extent(canvas.get_renderer()) for label in labels]
    assert [label.get_text() for label in labels] == ["3 125 rays", "6 250 rays", "800 000 rays"]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def test_a_step_whose_settings_are_shared_is_not_run_again() -> None:
    calls = []

    def cube(name: str) -> str:
        calls.append(name)
        return name

    first = Clock(repeats=3, keep=True)
    first("cube", lambda: cube("first"), key=1)
    second = Clock(kept=first.kept)
    assert second("cube", lambda: cube("again"), key=1) == "first"
    assert second("sorting", lambda: cube("other"), key=1) == "other"
    assert calls == ["first"] * 3 + ["other"]
    assert set(second.seconds()) == {"delays and spread"}


def test_the_rays_go_on_in_doublings_to_the_most() -> None:
    for menu, most, more in (
        (STUDY, 5_000_000, (1_600_000, 3_200_000, 5_000_000)),
        (QUICK, 800_000, (400_000, 800_000)),
    ):
        found = menu.with_more_rays(most)
        assert found.rays == (*menu.rays, *more)
        assert found.effort.reference_rays == max(2 * most, menu.effort.reference_rays)
        assert found.usual == menu.usual
    assert STUDY.usual == DEFAULT


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--most-rays", "800000"], "--most-rays: 800000, which are tried without it; expected more than 800000"),
        (["--most-rays", "200000", "--quick"], "expected more than 200000"),
        # 131 GB: 1300 bytes of a ray with two bounces, twice 50 million of them
        (["--most-rays", "50000000"], "131.3 GB of memory, 8.0 GB may be used; expected at most "),
    ],
)
def test_what_cannot_be_measured_is_refused_before_long_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: list[str], said: str
) -> None:
    monkeypatch.setattr(study, "usable_memory", lambda: 8e9)
    out = tmp_path / "prices"
    arguments = ["accuracy", "--scene", "scenes/tiny.usda", "--out", str(out), *more]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "400"})
    assert result.exit_code != 0
    found = f"{result.output} {result.exception}"
    assert said in found
    if "GB" in said:
        fitting = int(found.rsplit("at most ", 1)[1].split()[0].rstrip(".)"))
        assert fitting == pytest.approx(8e9 / (2 * memory.RAY_BYTES[2]), rel=0.25)
    assert not out.exists()
