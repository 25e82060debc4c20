"""The choice among measured prices, and the price list: errors fall where accuracy is bought, all is priced.

Frames under settings of the knobs are the run's own, what they are held against is exact or without its scatter. An
error budget is settled by them once, kept, and checked on the run.
"""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from oracles import doppler_filtered, if_cube, peak_error_db, relative_error
from path_tables import a_table
from sampled_frames import EFFECTS, MENU, POSE, TINY, order_of_two, samples_of
from typer.testing import CliRunner

from datafactory.accuracy import budget, study
from datafactory.accuracy.budget import HONEST_DB, check, first_middle_last
from datafactory.accuracy.cache import cached
from datafactory.accuracy.knobs import DEFAULT, KNOBS, POWER_KNOBS, QUICK, STUDY, Effort, Menu, menu_for
from datafactory.accuracy.looking import STAGES, Clock, made, reference_moments
from datafactory.accuracy.power import (
    FLOOR_DB,
    Errors,
    Realisations,
    compared,
    level_db,
    mean_and_variance,
    paired_error,
    peak_error,
    power_error,
    relative_l2,
    worst_of,
)
from datafactory.accuracy.prices import CUBE_S, Price, Prices, choose, front, trace_work, work
from datafactory.accuracy.study import DEFAULTS, FRONT, Row
from datafactory.cli.app import app
from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.paths.density import cell_power
from datafactory.paths.solver import TraceSettings
from datafactory.run import memory
from datafactory.run.pipeline import Execution, render
from datafactory.run.preparation import Order
from datafactory.scenes.materials.table import load_materials
from shared.dataset.folder import open_dataset
from shared.physics.errors import InputError
from shared.signal.imaging import sweep_moments


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


def test_errors_have_a_finite_floor_and_a_scale() -> None:
    one = np.array([3.0, 4.0j])
    assert relative_l2(one, one) == peak_error(one, one) == 0.0
    assert level_db(0.0) == -200.0
    assert relative_l2(1.1 * one, one) == pytest.approx(0.1)
    assert peak_error(one + np.array([0.4, 0.0]), one) == pytest.approx(0.1)
    assert relative_l2(one, 0.0 * one) == 1.0
    # Of what was not made there is none.
    paths = Errors.of([], [], [1e-2, 1e-3])
    assert paths.measured() == {"power_db": -40.0} == {"power_db": paths.worst_db}
    assert str(paths) == "power in a cell -40.0 dB"
    assert worst_of([paths, Errors.of([], [], [0.1])]) == Errors.of([], [], [0.1])
    both = worst_of([Errors.of([0.1], [0.1], [0.01]), Errors.of([1e-3], [1.0], [0.1])])
    assert both == Errors.of([0.1], [1.0], [0.1])


def test_reference_moments_are_those_of_the_whole_virtual_cube(radar, generator) -> None:
    table = a_table(generator, nearest_m=3.0, farthest_m=10.0)
    cells = np.random.default_rng(5).integers(0, radar.waveform.chirps, radar.waveform.range_bins)
    moments = reference_moments(table, radar, cells, 4)
    some = (0, 100, 255)  # elements of three blocks
    sensor = radar.virtual_sensor.model_copy(update={"rx_m": tuple(radar.virtual_sensor.rx_m[e] for e in some)})
    cube = if_cube(table, radar, sensor)
    for cell in np.unique(cells):
        rows = np.flatnonzero(cells == cell)
        expected = sweep_moments(doppler_filtered(cube, radar, int(cell)), radar, 4)[:, rows]
        assert peak_error_db(moments[:, rows][:, :, some], expected) < -100.0


def test_cell_power_keeps_the_power_of_every_path_in_range(samples, radar) -> None:
    paths, expected = samples[0].lit_paths(replace(DEFAULT, rays=2000)), 0.0
    for kind in (paths.scattered, paths.specular):
        inside = np.rint(kind.range_m() / radar.waveform.range_step_m) < radar.waveform.range_bins
        expected += (np.abs(kind.amplitude[inside]) ** 2).sum()
    assert expected > 0.0
    assert cell_power(paths, radar, "taylor-30").sum() == pytest.approx(expected, rel=1e-12)


def test_default_settings_are_those_of_a_run(samples) -> None:
    silent = ChainSettings(processing=Processing(noise=False))
    for name in NAMES:
        effects = ALL.without(name)
        sample = replace(samples[0], order=replace(samples[0].order, effects=effects))
        assert sample.settings(DEFAULT) == effects.settings(silent)
    # What a frame decides to leave out is decided by the run's budget; a complete frame has all of it.
    deciding = replace(samples[0], order=replace(samples[0].order, effects=None, budget_db=-25.0))
    assert deciding.settings(DEFAULT).budget_db == -25.0
    assert deciding.complete().settings(DEFAULT) == ALL.settings(silent)
    # Measurements are kept by the settings, of which the device is one.
    order = samples[0].order
    on_gpu = replace(samples[0], order=replace(order, settings=replace(order.settings, device="cuda")))
    assert on_gpu.settings(DEFAULT) == replace(samples[0].settings(DEFAULT), device="cuda")


@pytest.mark.parametrize("left_out", [(), ("doppler",), ("near_field", "antenna_pattern")])
def test_a_frame_of_the_study_is_a_frame_of_the_run(left_out, radar, tmp_path, variant) -> None:
    """Rendered by the pipeline itself, without noise."""
    effects = EffectSet.of(set(EFFECTS.names) - {"noise", *left_out})
    settings = ChainSettings(trace=TraceSettings(rays=1000), processing=Processing(store="cube"))
    order = replace(order_of_two(radar), poses=(POSE,), effects=effects, seed=5, settings=settings)
    render(order, load_materials(None), Execution(tmp_path / "data"))
    (expected,) = open_dataset(tmp_path / "data").frames("train")

    (sample,) = samples_of(order)
    knobs = replace(DEFAULT, rays=1000)
    outcome = made([sample.traced(knobs)], sample.settings(knobs), radar)
    assert expected.cube is not None
    assert relative_error(outcome.cubes[0], expected.cube) < 1e-6
    assert peak_error_db(outcome.images[0], expected.image * expected.image_peak) < -60.0


CELLS = (96, 20)


def test_the_scatter_of_a_frame_does_not_contain_that_of_its_reference(generator) -> None:
    """One cell of Gamma power of shape k = 50: its amplitude scatters by sqrt(1 / 4 k), known whatever the reference
    is."""
    many = Realisations(generator.gamma(50.0, 1.0 / 50.0, (4000, 1, 1)), 0.0)
    squares, biased = [], []
    for _ in range(200):
        mean, variance = mean_and_variance(generator.gamma(50.0, 1.0 / 50.0, (3, 1, 1)))
        difference = (np.sqrt(many.power) - np.sqrt(mean)) ** 2
        squares.append(float((difference - variance).mean()))
        biased.append(float(difference.mean()))
    assert np.mean(squares) == pytest.approx(1.0 / 200.0, rel=0.1)
    assert np.mean(biased) == pytest.approx(4.0 / 3.0 / 200.0, rel=0.1)
    assert not mean_and_variance(many.power[:1])[1].any()


def test_cells_are_compared_as_stated() -> None:
    reference = np.ones(CELLS)
    reference[20, 1] = 4.0
    value = reference.copy()
    value[10, 0] = 4.0
    error = compared(Realisations(value[None], 7.0), reference, np.zeros(1))
    assert error.peak == pytest.approx(0.5)
    assert error.total == pytest.approx((reference.sum() + 3.0) / reference.sum())
    assert error.paths == 7.0
    # What the reference's own scatter explains is no error.
    assert compared(Realisations(value[None], 7.0), reference, np.ones(1)).peak == 0.0
    nothing = compared(Realisations(0.0 * value[None], 0.0), 0.0 * reference, np.zeros(1))
    assert (nothing.peak, nothing.total) == (0.0, 1.0)


def test_draws_are_independent_and_repeatable(samples) -> None:
    knobs, effort, (sample,) = replace(DEFAULT, rays=1000), Effort(4000, 2, 2), samples
    against = replace(knobs, rays=4000)
    errors = [power_error(sample, knobs, sample, against, effort, {}, draw) for draw in (0, 0, 1)]
    assert errors[0] == errors[1] != errors[2]
    paired = paired_error(sample, knobs, knobs, effort, {})
    assert (paired.peak, paired.total) == (0.0, 1.0)


def settled(order: Order, level_db: float, menu: Menu, said: list[str], folder: Path) -> budget.Budget:
    return budget.settle(
        order, load_materials(None), level_db, menu, said.append, lambda label, done, total: None, folder
    )


def entry_of(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["error_budget"]


def test_a_budget_on_two_scenes_is_settled_once_kept_and_checked(variant, radar, tmp_path, monkeypatch) -> None:
    """From frame 8 on the scenes' turn is another: frames that are measured and checked must be the run's."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.usda").write_text(TINY.read_text(encoding="utf-8"), encoding="utf-8")
    scenes = tuple(str(tmp_path / f"{name}.usda") for name in ("one", "two"))
    order, said = Order(radar=radar, scenes=scenes, frames=16, effects=EFFECTS, seed=1), list[str]()
    found = settled(order, -15.0, MENU, said, tmp_path / "cache")
    assert [[sample.frame_id for sample in scene.swept] for scene in found.scenes] == [[0, 9], [1, 8]]
    assert sum("measuring" in line for line in said) == 2
    with monkeypatch.context() as patch:
        patch.setattr(budget, "measure_prices", lambda *arguments: pytest.fail("measured again"))
        assert settled(order, -15.0, MENU, said, tmp_path / "cache").choice == found.choice
        assert settled(order, -60.0, MENU, said, tmp_path / "cache").choice.work >= found.choice.work
    assert found.choice.settings.on(order.settings) == found.order.settings

    render(found.order, load_materials(None), Execution(tmp_path / "data"))
    check(found, tmp_path / "data", said.append)
    entry = entry_of(tmp_path / "data")
    assert entry["budget_db"] == -15.0
    assert entry["predicted"] == found.choice.predicted.model_dump()
    assert entry["settings"] == vars(found.choice.settings)
    # The rays are drawn anew for the check, and all settings act at once.
    for error in ("cube_db", "image_db", "power_db"):
        assert abs(entry["achieved"][error] - entry["predicted"][error]) <= HONEST_DB
    assert max(entry["achieved_on_other_frames"].values()) < 0.0
    assert "seconds" not in json.dumps(entry)


def test_a_budget_of_traced_paths_bounds_the_power_in_cells_alone(variant, radar, tmp_path) -> None:
    order, said = replace(order_of_two(radar), poses=(POSE,)), list[str]()
    found = settled(order, -15.0, MENU.of_paths(), said, tmp_path / "cache")
    assert found.order.settings.trace.rays in MENU.rays
    render(replace(found.order, paths_alone=True), load_materials(None), Execution(tmp_path / "paths"))
    check(found, tmp_path / "paths", said.append)
    entry = entry_of(tmp_path / "paths")
    assert set(entry["predicted"]) == set(entry["achieved"]) == {"power_db"}
    assert set(entry["settings"]) == {"rays", "depth"}
    assert entry["work_per_frame"] > 0.0
    assert abs(entry["achieved"]["power_db"] - entry["predicted"]["power_db"]) <= HONEST_DB


@pytest.mark.parametrize(
    ("own", "chosen"),
    [(range(0), ()), (range(5, 6), (5,)), (range(2), (0, 1)), (range(1, 100, 3), (1, 49, 97)), (range(9), (0, 4, 8))],
)
def test_frames_that_are_looked_at_are_spread_over_the_run(own: range, chosen: tuple[int, ...]) -> None:
    assert first_middle_last(own) == chosen


def test_a_budget_needs_scenes(radar) -> None:
    with pytest.raises(InputError, match="--error-budget"):
        budget.settle(Order(radar=radar, points=3), load_materials(None), -30.0, MENU, print, lambda *a: None)
