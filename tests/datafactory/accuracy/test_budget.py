"""An error budget: settled once, kept, checked on the run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from sampled_frames import EFFECTS, MENU, POSE, TINY, order_of_two

from datafactory.accuracy import budget
from datafactory.accuracy.budget import HONEST_DB, check
from datafactory.accuracy.knobs import Menu
from datafactory.run.order import Order
from datafactory.run.pipeline import Execution, render, trace_paths
from datafactory.scenes.materials.table import load_materials
from shared.physics.errors import InputError


def settled(order: Order, level_db: float, menu: Menu, said: list[str], folder: Path) -> budget.Budget:
    return budget.settle(
        order, load_materials(None), level_db, menu, said.append, lambda done, total, label: None, folder
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
    trace_paths(found.order, load_materials(None), Execution(tmp_path / "paths"))
    check(found, tmp_path / "paths", said.append)
    entry = entry_of(tmp_path / "paths")
    assert set(entry["predicted"]) == set(entry["achieved"]) == {"power_db"}
    assert set(entry["settings"]) == {"rays", "depth"}
    assert entry["work_per_frame"] > 0.0
    assert abs(entry["achieved"]["power_db"] - entry["predicted"]["power_db"]) <= HONEST_DB


def test_a_budget_needs_scenes(radar) -> None:
    with pytest.raises(InputError, match="--error-budget"):
        budget.settle(Order(radar=radar, points=3), load_materials(None), -30.0, MENU, print, lambda *a: None)
