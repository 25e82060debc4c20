"""The pair test frame by frame: what each frame of an effect scene is made with, and how far that is from everything.

The plan of a run says which paths a frame is traced with; the frame's own paths say which effects of the signal it is
made with. Both together are the set written down beforehand, in every frame, and the frame differs from the frame of
every effect by no more than the budget.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from prepared_scenes import EFFECT_SCENES as EFFECTS

from datafactory.effects import proof
from datafactory.frame.chain import ChainSettings, SceneSource, narrowed
from datafactory.frame.deal import DealtFrame
from datafactory.frame.defaults import DEFAULT_BUDGET_DB
from datafactory.paths.solver import TraceSettings
from datafactory.run.order import Order
from datafactory.run.preparation import Prepared, prepare
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("own_cache", "one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]
ALWAYS = ("range_migration", "intra_chirp_motion", "near_field")
"""Whatever a frame calls for: leaving them out saves nothing."""
RADAR = Radar()
RAYS = 50_000
"""Of the frames; the evidence has its own."""


def made_with(frame: DealtFrame, prepared: Prepared, settings: ChainSettings) -> set[str]:
    """The effects that a frame is made with, after it was traced."""
    traced = SceneSource(frame, prepared.scenes[0], settings).traced(RADAR)
    made, _ = narrowed(traced, settings, RADAR)
    return {effect for effect, on in (made.path_effects() | made.frame_effects()).items() if on}


@pytest.mark.parametrize("name", EXPECTED)
def test_every_frame_has_what_was_written_down_and_leaves_out_no_more_than_the_budget(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Input image, truth image and power in cells against the same frame with every effect, nothing pruned."""
    monkeypatch.setattr(proof, "frame_seconds", lambda *of: 0.0)
    poses = read_poses(EFFECTS / f"{name}.poses.json")
    settings = ChainSettings(trace=TraceSettings(rays=RAYS))
    order = Order(radar=RADAR, scenes=(str(EFFECTS / f"{name}.usda"),), poses=poses, settings=settings)
    prepared = prepare(order, load_materials())
    for index, pose in enumerate(poses):
        made = made_with(prepared.deal.frame(index), prepared, prepared.plans[0].settings(settings, pose))
        assert made == {*EXPECTED[name]["effects"], *ALWAYS}, f"frame {index}"
    frame, planned = prepared.deal.frame(0), prepared.plans[0].settings(settings, poses[0])
    found = proof.prove(frame, prepared.scenes[0], RADAR, settings, planned)
    assert found.input_db < DEFAULT_BUDGET_DB
    assert found.truth_db < DEFAULT_BUDGET_DB
