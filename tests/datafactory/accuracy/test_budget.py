"""An error budget: settled once, kept, checked on the run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from sampled_frames import EFFECTS, MENU, POSE, TINY, order_of_two

from datafactory.accuracy import budget
from datafactory.accuracy.check import HONEST_DB, check
from datafactory.accuracy.prices import Errors, Menu
from datafactory.run.making import render, trace_paths
from datafactory.run.order import Order
from datafactory.run.pipeline import Execution
from datafactory.scenes.materials.table import load_materials
from shared.physics.errors import InputError


def settled(order: Order, level_db: float, menu: Menu, said: list[str], folder: Path) -> budget.Budget:
    return budget.settle(
        order, load_materials(None), level_db, menu, said.append, lambda done, total, label: None, folder
    )


def test_a_budget_is_settled_once_kept_and_checked(variant, radar, tmp_path, monkeypatch):
    order, said = order_of_two(radar), list[str]()
    first = settled(order, -20.0, MENU, said, tmp_path / "cache")
    assert any("measuring" in line for line in said)
    with monkeypatch.context() as patch:
        patch.setattr(budget, "measure_prices", lambda *arguments: pytest.fail("swept again"))
        second = settled(order, -20.0, MENU, said, tmp_path / "cache")
        tighter = settled(order, -60.0, MENU, said, tmp_path / "cache")
    assert second.choice == first.choice
    assert tighter.choice.work >= first.choice.work
    assert first.order.settings.trace.rays == first.choice.settings.rays
    assert first.order.settings.prune_db == first.choice.settings.prune_db
    assert first.order.settings.processing.truth_terms == first.choice.settings.truth_terms

    render(first.order, load_materials(None), Execution(tmp_path / "data"))
    check(first, tmp_path / "data", said.append)
    entry = json.loads((tmp_path / "data" / "manifest.json").read_text(encoding="utf-8"))["error_budget"]
    assert entry["budget_db"] == -20.0
    assert entry["predicted"] == first.choice.predicted.model_dump()
    assert entry["settings"]["rays"] == first.choice.settings.rays
    # The rays are drawn anew for the check, and all settings act at once.
    for error in ("cube_db", "image_db", "power_db"):
        assert abs(entry["achieved"][error] - entry["predicted"][error]) <= HONEST_DB
    assert "seconds" not in json.dumps(entry)


def test_a_budget_of_traced_paths_bounds_the_power_in_cells_alone(variant, radar, tmp_path):
    said = list[str]()
    order = replace(order_of_two(radar), poses=(POSE,))
    found = settled(order, -15.0, MENU.of_paths(), said, tmp_path / "cache")
    assert found.order.settings.trace.rays in MENU.rays
    trace_paths(found.order, load_materials(None), Execution(tmp_path / "paths"))
    check(found, tmp_path / "paths", said.append)
    entry = json.loads((tmp_path / "paths" / "manifest.json").read_text(encoding="utf-8"))["error_budget"]
    assert set(entry["predicted"]) == set(entry["achieved"]) == {"power_db"}
    assert set(entry["settings"]) == {"rays", "depth"}
    assert entry["work_per_frame"] > 0.0
    assert abs(entry["achieved"]["power_db"] - entry["predicted"]["power_db"]) <= HONEST_DB


def test_a_budget_needs_scenes(radar):
    with pytest.raises(InputError, match="--error-budget"):
        budget.settle(Order(radar=radar, points=3), load_materials(None), -30.0, MENU, print, lambda *a: None)


def test_given_rays_and_depth_stay():
    menu = budget.menu_for(3_000_000, 1)
    assert menu.rays == (3_000_000,)
    assert menu.depth == (1,)
    assert menu.effort.reference_rays > 3_000_000
    assert menu.of_paths().rays == menu.rays
    assert menu.of_paths().paths_only
    assert not menu.paths_only


def test_errors_leave_out_what_was_not_made():
    paths = Errors.of([], [], [1e-2, 1e-3])
    assert paths.measured() == {"power_db": -40.0} == {"power_db": paths.worst_db}
    assert str(paths) == "power in a cell -40.0 dB"
    both = budget.worst_of([Errors.of([0.1], [0.1], [0.01]), Errors.of([1e-3], [1.0], [0.1])])
    assert both == Errors.of([0.1], [1.0], [0.1])


def test_a_budget_on_two_scenes_keeps_what_it_says(variant, radar, tmp_path) -> None:
    """From frame 8 on the scenes' turn is another: frames that are swept and checked must be the run's."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.usda").write_text(TINY.read_text(encoding="utf-8"), encoding="utf-8")
    scenes = tuple(str(tmp_path / f"{name}.usda") for name in ("one", "two"))
    order = Order(radar=radar, scenes=scenes, frames=16, effects=EFFECTS, seed=1)
    lines = list[str]()
    found = settled(order, -15.0, MENU, lines, tmp_path / "cache")
    assert [[sample.frame_id for sample in scene.swept] for scene in found.scenes] == [[0, 9], [1, 8]]
    render(found.order, load_materials(None), Execution(tmp_path / "data"))
    check(found, tmp_path / "data", lines.append)
    entry = json.loads((tmp_path / "data" / "manifest.json").read_text(encoding="utf-8"))["error_budget"]
    for error in ("cube_db", "image_db", "power_db"):
        assert abs(entry["achieved"][error] - entry["predicted"][error]) <= HONEST_DB
    assert max(entry["achieved_on_other_frames"].values()) < 0.0
