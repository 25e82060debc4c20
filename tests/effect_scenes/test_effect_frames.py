"""The pair test frame by frame: what each frame of an effect scene is made with, and how far that is from everything.

A frame decides by itself. What it is made with is the set written down beforehand, in every frame and whatever the
rays, and the frame differs from the frame of every effect by no more than the budget.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from prepared_scenes import EFFECT_SCENES as EFFECTS
from prepared_scenes import prepared_scene

from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects import proof
from datafactory.effects.catalogue import ALL
from datafactory.effects.plan import plan_of_frame
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import Deal
from datafactory.paths.solver import TraceSettings
from datafactory.scenes.poses import read_poses
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]
RADAR = Radar()
SETTINGS = replace(ALL.settings(ChainSettings(trace=TraceSettings())), budget_db=DEFAULT_BUDGET_DB)


def made_with(name: str, seed: int = 0) -> list[list[str]]:
    """The effects of every frame of a scene."""
    scene = prepared_scene(EFFECTS / f"{name}.usda")
    deal = Deal(seed=seed, scenes=1, poses=read_poses(EFFECTS / f"{name}.poses.json"))
    plans = [plan_of_frame(deal.frame(index), scene, RADAR, SETTINGS) for index in range(len(deal))]
    return [sorted(effect for effect, on in plan.effects.items() if on) for plan in plans]


@pytest.mark.parametrize("name", EXPECTED)
def test_every_frame_has_what_was_written_down(name: str) -> None:
    expected = sorted(EXPECTED[name]["effects"])
    assert made_with(name) == [expected] * len(read_poses(EFFECTS / f"{name}.poses.json"))


@pytest.mark.parametrize("seed", [1, 5])
def test_the_decision_does_not_hang_on_the_rays(seed: int) -> None:
    """The scene whose rough surface, at 80 m, has the fewest rays in a cell."""
    (one, *others) = made_with("reflector_behind_pane", seed)
    assert one == sorted(EXPECTED["reflector_behind_pane"]["effects"])
    assert all(other == one for other in others)


@pytest.mark.parametrize("name", EXPECTED)
def test_what_is_left_out_is_within_the_budget(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Input image, truth image and power in cells against the same frame with every effect, nothing pruned."""
    monkeypatch.setattr(proof, "frame_seconds", lambda *of: 0.0)
    scene = prepared_scene(EFFECTS / f"{name}.usda")
    frame = Deal(scenes=1, poses=read_poses(EFFECTS / f"{name}.poses.json")).frame(0)
    assert proof.prove(frame, scene, RADAR, SETTINGS).worst_db < DEFAULT_BUDGET_DB
