"""The choice among measured prices, and the price list: errors fall where accuracy is bought, all is priced."""

import csv
import json
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from datafactory.accuracy import study
from datafactory.accuracy.cache import cached
from datafactory.accuracy.knobs import DEFAULT, KNOBS, POWER_KNOBS, QUICK, STUDY, Menu, menu_for
from datafactory.accuracy.looking import STAGES, Clock
from datafactory.accuracy.power import FLOOR_DB
from datafactory.accuracy.prices import CUBE_S, Price, Prices, choose, front, trace_work, work
from datafactory.accuracy.study import DEFAULTS, FRONT, Row
from datafactory.cli.app import app
from datafactory.run import memory


def price_list(menu: Menu, power: float = 1.0, power_floor: float = 0.0) -> Prices:
    """Errors that fall as the settings get dearer, as they are measured.

    :param power: factor of the errors of the power
    """
    entries = []
    for knob in KNOBS:
        for place, value in enumerate(getattr(menu, knob)):
            error = (0.1 * 0.2**place,)
            entries.append(
                Price(
                    knob=knob,
                    value=value,
                    cube=error if knob in ("tolerance", "prune_db") else (),
                    image=error if knob in ("truth_terms", "prune_db") else (),
                    power=(max(power * error[0], power_floor),) if knob in POWER_KNOBS else (),
                    bias=(1.0,),
                    paths={"prune_db": 90.0, "rays": 0.7 * value}.get(knob, 100.0),
                )
            )
    return Prices(prices=tuple(entries))


def test_the_front_buys_accuracy_with_work(radar) -> None:
    levels, choices = zip(*front(price_list(Menu()), Menu(), radar), strict=True)
    assert len(levels) > 3
    assert all(a > b for a, b in pairwise(levels))
    assert all(a.work < b.work for a, b in pairwise(choices))
    assert all(choice.predicted.worst_db <= level for level, choice in zip(levels, choices, strict=True))
    assert len({choice.settings for choice in choices}) == len(choices)


def test_the_cheapest_choice_that_keeps_the_budget(radar) -> None:
    menu, levels = Menu(), (-18.0, -25.0, -32.0, -40.0)
    prices = price_list(menu)
    found = [choose([prices], menu, level, radar) for level in levels]
    assert [choice.work for choice in found] == sorted(choice.work for choice in found)
    assert found[0].work < found[-1].work
    for level, choice in zip(levels, found, strict=True):
        assert choice.keeps_budget
        assert choice.predicted.worst_db <= level
    hopeless = choose([prices], menu, -119.0, radar)
    assert not hopeless.keeps_budget
    assert hopeless.settings.depth == menu.depth[-1]
    # What cannot be kept is as good as the menu has it, and the rest is kept and no better.
    rest = choose([price_list(menu, power_floor=0.3)], menu, -32.0, radar)
    assert not rest.keeps_budget
    kept = [level for name, level in rest.predicted.measured().items() if name != "power_db"]
    assert rest.predicted.power_db > -32.0 >= max(kept)
    assert len(kept) == 2
    assert rest.settings.tolerance > menu.tolerance[-1]
    # Two scenes: the choice answers for the worse one.
    both = choose([prices, price_list(menu, power=3.0)], menu, -25.0, radar)
    assert both.settings.rays > found[1].settings.rays
    # Of paths alone only how they are traced is chosen, by what the trace takes.
    paths = choose([price_list(menu.of_paths())], menu.of_paths(), -25.0, radar)
    assert set(paths.predicted.measured()) == {"power_db"}
    assert paths.settings == replace(DEFAULT, rays=paths.settings.rays, depth=paths.settings.depth)
    assert paths.work == trace_work(paths.settings)


def test_work_rises_with_all_that_is_bought(radar) -> None:
    for menu in (Menu(), STUDY, QUICK):
        assert set(menu.tolerance) <= set(CUBE_S)
        for knob in ("rays", "depth", "tolerance", "truth_terms"):
            found = [work(DEFAULT.at(knob, value), 1e5, radar) for value in getattr(menu, knob)]
            assert all(a < b for a, b in pairwise(found))
    assert work(DEFAULT, 1e4, radar) < work(DEFAULT, 1e5, radar)
    # Few rays are not for nothing: every pass has its price, and a single bounce has one pass of three.
    few = replace(DEFAULT, rays=1)
    assert abs(trace_work(few) / trace_work(replace(few, depth=1)) - 3.0) < 1e-3


def test_given_rays_and_depth_stay() -> None:
    menu = menu_for(3_000_000, 1)
    assert (menu.rays, menu.depth) == ((3_000_000,), (1,))
    assert menu.effort.reference_rays > 3_000_000
    assert menu.of_paths().rays == menu.rays
    assert menu.of_paths().paths_only
    assert not menu.paths_only
    # More rays go on in doublings to the most.
    for menu, most, more in (
        (STUDY, 5_000_000, (1_600_000, 3_200_000, 5_000_000)),
        (QUICK, 800_000, (400_000, 800_000)),
    ):
        found = menu.with_more_rays(most)
        assert found.rays == (*menu.rays, *more)
        assert found.effort.reference_rays == max(2 * most, menu.effort.reference_rays)
        assert found.usual == menu.usual
    assert STUDY.usual == DEFAULT


PRICES = Prices(prices=(Price(knob="rays", value=1.0, power=(0.1,), bias=(1.0,), paths=7.0),))


def test_a_damaged_cache_is_measured_again(tmp_path: Path) -> None:
    said: list[str] = []
    paths: list[Path] = []

    def measure(path: Path) -> Prices:
        paths.append(path)
        return PRICES

    for _ in range(2):
        assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 1
    paths[0].write_text("{")
    assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 2
    assert len(said) == 1
    cached(tmp_path, {"scene": "b"}, Prices, measure, said.append)
    assert paths[2] != paths[0]


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


def test_every_row_is_priced_and_the_front_keeps_what_it_promises(prices) -> None:
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
    # What was predicted from single knobs is what all of them have together, to a decibel or two.
    front = [row for row in prices.rows if row.knob == FRONT]
    levels = [float(row.setting.split(" dB")[0]) for row in front]
    assert len(levels) > 1
    assert all(a > b for a, b in pairwise(levels))
    assert all(row.worst_db <= promised + 2.0 for row, promised in zip(front, levels, strict=True))


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


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--most-rays", "200000", "--quick"], "200000, which are tried without it; expected more than 200000"),
        # 131 GB: 1300 bytes of a ray with two bounces, twice 50 million of them
        (["--most-rays", "50000000"], "131.3 GB of memory, 8.0 GB may be used; expected at most "),
        (["--rays", "20000000"], "a reference of 40000000 rays takes 53.3 GB of memory, 8.0 GB may be used"),
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
