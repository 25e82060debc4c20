"""Frames under settings of the knobs are the run's own, what they are held against is exact or without its scatter.

An error budget is settled by them once, kept, and checked on the run.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles import doppler_filtered, if_cube, peak_error_db, relative_error
from path_tables import a_table
from prepared_scenes import TINY
from sampled_frames import EFFECTS, MENU, POSE, order_of_two, samples_of

from datafactory.accuracy import budget
from datafactory.accuracy.budget import HONEST_DB, check, first_middle_last
from datafactory.accuracy.knobs import DEFAULT, Effort, Menu
from datafactory.accuracy.looking import made, reference_moments
from datafactory.accuracy.power import (
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
from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.paths.cells import cell_power
from datafactory.paths.solver import TraceSettings
from datafactory.run.pipeline import Execution, render
from datafactory.run.preparation import Order
from datafactory.scenes.materials.table import load_materials
from shared.dataset.folder import open_dataset, read_manifest
from shared.physics.errors import InputError
from shared.signal.imaging import sweep_moments


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
    return read_manifest(folder)["error_budget"]


def test_a_budget_on_two_scenes_is_settled_once_kept_and_checked(variant, radar, tmp_path, monkeypatch) -> None:
    """From frame 8 on the scenes' turn is another: frames that are measured and checked must be the run's."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.usda").write_text(TINY.read_text(encoding="utf-8"), encoding="utf-8")
    scenes = tuple(str(tmp_path / f"{name}.usda") for name in ("one", "two"))
    order, said = Order(radar=radar, scenes=scenes, frames=16, effects=EFFECTS, seed=1), list[str]()
    found = settled(order, -15.0, MENU, said, tmp_path / "cache")
    assert [[sample.frame.frame_id for sample in scene.swept] for scene in found.scenes] == [[0, 9], [1, 8]]
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

    # A frame that was not swept may break the budget alone.
    swept, kept = [scene.swept for scene in found.scenes], Errors(**entry["achieved"])
    broken = kept.model_copy(update={"image_db": -5.0})
    monkeypatch.setattr(budget, "errors_together", lambda samples, *_: kept if samples in swept else broken)
    check(found, tmp_path / "data", said.append)
    assert said[-1] == "warning: the error budget of -15 dB is not kept"
    assert not entry_of(tmp_path / "data")["keeps_budget"]


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


def test_an_interrupted_sweep_says_that_it_is_not_kept(variant, radar, tmp_path, monkeypatch) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    said = list[str]()
    monkeypatch.setattr(budget, "measure_prices", interrupted)
    with pytest.raises(KeyboardInterrupt):
        settled(replace(order_of_two(radar), poses=(POSE,)), -15.0, MENU, said, tmp_path / "cache")
    assert said[-1] == "tiny: what was measured of its accuracy is not kept, and will be measured again"


def test_a_budget_needs_scenes(radar) -> None:
    with pytest.raises(InputError, match="--error-budget"):
        budget.settle(Order(radar=radar, points=3), load_materials(None), -30.0, MENU, print, lambda *a: None)
