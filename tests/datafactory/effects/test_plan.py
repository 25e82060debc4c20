"""Effects by name and what switching one off means; what frames decide, said aloud, and the plan's contract."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from prepared_scenes import prepared_scene
from usd_files import mesh, write_usda

from datafactory.accuracy import proof
from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects.catalogue import ALL, DESCRIPTIONS, NAMES, PATH_EFFECTS, EffectSet, parse_effects
from datafactory.effects.plan import FLOOR_DB, FramePlan, Loss, plan_of_frame, plan_of_scene
from datafactory.frame.chain import ChainSettings, SceneSource
from datafactory.frame.deal import Deal, DealtFrame, PreparedScene
from datafactory.frame.measurement import Processing
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.solver import TraceSettings
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from shared.physics.errors import InputError
from shared.radar import FrontEnd, Radar

NOISE, BUDGET = "the receiver's noise", "the error budget"


def a_frame_plan(limit: str = NOISE, **change_db: float) -> FramePlan:
    """A frame made with what is named here at more than -60 dB, and with nothing else."""
    losses = {name: Loss(change_db[name], 0.25, 0.05) if name in change_db else Loss() for name in NAMES}
    bounds: dict[str, float] = {name: change_db[name] for name in ("diffraction", "corners") if name in change_db}
    made = {name: change_db.get(name, FLOOR_DB) > -60.0 for name in NAMES}
    return FramePlan(made, losses, bounds, frozenset(name for name in bounds if made[name]), limit)


def test_a_plan_in_json_is_the_contract_s() -> None:
    plan = plan_of_scene("street", [a_frame_plan(diffuse=-3.14, near_field=-0.001, noise=0.0)], -20.0)
    document = json.loads(json.dumps(plan.to_json()))
    assert set(document) == {"scene", "budget_db", "effects"}
    assert (document["scene"], document["budget_db"]) == ("street", -20.0)
    assert [item["effect"] for item in document["effects"]] == list(NAMES)
    for item in document["effects"]:
        assert set(item) == {"effect", "on", "reason", "evidence", "loss_db"}  # cost_seconds joins them in the CLI
        assert isinstance(item["on"], bool)
        assert item["reason"]
        assert "\n" not in item["reason"] + item["evidence"]
    levels = {item["effect"]: item["loss_db"] for item in document["effects"]}
    assert levels["diffuse"] == -3.1
    assert str(levels["near_field"]) == "0.0"  # and not the minus nothing that rounding leaves
    assert plan.effects.names == ("diffuse", "near_field", "noise")


def test_a_reason_says_by_what_and_in_how_many_frames() -> None:
    some = [a_frame_plan(diffuse=-12.34, diffraction=-44.4), a_frame_plan(BUDGET, diffuse=-14.0, diffraction=-70.0)]
    plan = plan_of_scene("scene", some, DEFAULT_BUDGET_DB)
    reasons = {item.effect: item.reason for item in plan.decisions}
    assert reasons["diffuse"].endswith(": -12.3 dB of the peak without it, in 2 of 2 frames")
    kept = "-44.4 dB of the peak without it, in 1 of 2 frames; the limit is the receiver's noise"
    assert reasons["diffraction"].endswith(kept)  # that of the frame which has it
    assert ": 0.0 dB" in plan_of_scene("scene", [a_frame_plan(diffuse=-0.04)], -30.0).decisions[1].reason
    assert reasons["corners"] == "no two faces at a right angle look at the radar"
    left_out = plan_of_scene("scene", [a_frame_plan(corners=-75.0)], DEFAULT_BUDGET_DB)
    reason = next(item.reason for item in left_out.decisions if item.effect == "corners")
    assert reason.endswith("each at most -75.0 dB of the peak, all of it below the receiver's noise")
    dim = replace(a_frame_plan(BUDGET, corners=-37.4), effects=dict.fromkeys(NAMES, False))
    hidden = replace(dim, losses=dict.fromkeys(NAMES, Loss()))
    below = "what is in sight is -37.4 dB of the peak, all of it below the error budget"
    for frame, told in ((hidden, "nothing of it is in sight"), (dim, below)):
        reason = next(i.reason for i in plan_of_scene("scene", [frame], -30.0).decisions if i.effect == "corners")
        assert told in reason
        assert ("nothing" in reason) == (frame is hidden)
    elsewhere = plan_of_scene("elsewhere", [], DEFAULT_BUDGET_DB)  # where no frame stands
    assert elsewhere.effects.names == ()
    assert {item.reason for item in elsewhere.decisions} == {"no frame of the run stands in this scene"}


def test_costs_are_differences_to_the_frame_of_every_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of 1 s a frame and 0.5 s an effect; what the frame lacks and what is no choice costs nothing."""
    of_settings = {effects.settings(ChainSettings()): effects for effects in (*(ALL.without(n) for n in NAMES), ALL)}

    def frame_seconds(source: SceneSource, radar: object) -> float:
        return 1.0 + 0.5 * len(of_settings[source.settings].names)

    plan = plan_of_scene("scene", [a_frame_plan(specular=0.0, diffuse=-50.0, noise=0.0, near_field=-9.0)], -30.0)
    monkeypatch.setattr(proof, "frame_seconds", frame_seconds)
    steps: list[tuple[str, int, int]] = []
    frame, scene = a_frame()
    source = SceneSource(frame, scene, ChainSettings(budget_db=-30.0))
    result = proof.costs(source, Radar(), plan, lambda *step: steps.append(step))
    assert result == {name: 0.5 if name in ("specular", "diffuse", "noise") else 0.0 for name in NAMES}
    assert [step[1] for step in steps] == list(range(steps[0][2]))
    with pytest.raises(ValueError, match="budget_db"):
        plan_of_frame(replace(source, settings=ChainSettings()), Radar())  # frames decide by a budget


def a_frame() -> tuple[DealtFrame, PreparedScene]:
    """Of an empty scene; nothing is traced."""
    materials = load_materials().map_materials([])
    scene = PreparedScene("empty", "none", MergedScene((), ()), materials)
    return DealtFrame(0, "scene", "train", 1, scene=0, pose=Pose((0.0, 0.0, 0.5))), scene


pytestmark = pytest.mark.usefixtures("variant")


def sheet(near: float, far: float) -> str:
    return mesh("sheet", [(near, -3, 0), (far, -3, 0), (far, 3, 0), (near, 3, 0)], [range(4)], "metal")


POST = """def Xform "post" {
    custom double radar:rcs_dbsm = 5
    double3 xformOp:translate = (30, 0, 0.7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
POSE = Pose((0.0, 0.0, 0.5))


def scene(tmp_path: Path, *prims: str) -> PreparedScene:
    return prepared_scene(write_usda(tmp_path, "".join(prims)))


def planned(prepared: PreparedScene) -> set[str]:
    frame = Deal(seed=0, scenes=1, poses=(POSE,)).frame(0)
    settings = replace(ALL.settings(ChainSettings()), budget_db=DEFAULT_BUDGET_DB)
    return {name for name, on in plan_of_frame(SceneSource(frame, prepared, settings), Radar()).effects.items() if on}


def test_a_bounce_is_planned_where_there_is_one(tmp_path: Path) -> None:
    """The wave is reflected at 12.5 m: on the sheet that is there, beside the one that ends before."""
    below = planned(scene(tmp_path, POST, sheet(near=9, far=20)))
    assert {"rcs_targets", "multi_bounce", "specular"} <= below
    before = planned(scene(tmp_path, POST, sheet(near=2, far=11)))
    assert "rcs_targets" in before
    assert "multi_bounce" not in before


CONTRACT = (
    "specular", "diffuse", "multi_bounce", "refraction", "diffraction", "corners", "doppler",
    "range_migration", "intra_chirp_motion", "near_field", "antenna_pattern", "rcs_targets", "noise",
)  # fmt: skip
"""Names and order as users' scripts know them."""


def test_effects_are_read_from_the_command_line() -> None:
    assert NAMES == CONTRACT == tuple(DESCRIPTIONS)
    assert parse_effects("auto") is None
    assert parse_effects("all") == ALL
    assert parse_effects(" noise, specular ,diffuse,") == EffectSet.of({"specular", "diffuse", "noise"})
    assert EffectSet.of({"noise", "specular"}).names == ("specular", "noise")


@pytest.mark.parametrize("text", ["auto,noise", "all,near_field", "noise,all"])
def test_auto_and_all_stand_alone(text: str) -> None:
    alone = "auto" if "auto" in text else "all"
    with pytest.raises(InputError, match=f"^--effects: '{alone}' beside other names; expected {alone} alone"):
        parse_effects(text)


@pytest.mark.parametrize("text", ["specular,nonsense", "Specular", "a\nb", ""])
def test_a_name_that_does_not_exist_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_effects(text)
    wrong = next(name for name in text.split(",") if name not in NAMES)
    assert str(caught.value).startswith(f"--effects: {wrong!r}; expected auto, all, or some of {','.join(CONTRACT)}")


def test_each_effect_sets_one_field_of_trace_or_processing() -> None:
    settings = ChainSettings(trace=TraceSettings(rays=7, depth=3, polarization=("V", "H")))
    everything = ALL.settings(settings).trace
    assert everything == replace(settings.trace, refraction=True, diffraction=True, corners=True)
    for name in NAMES:
        left = ALL.without(name).settings(settings).trace
        fields: dict[str, dict[str, Any]] = {"multi_bounce": {"depth": 1}, "rcs_targets": {"point_targets": False}}
        expected = fields.get(name, {name: False} if name in PATH_EFFECTS else {})
        assert left == replace(everything, **expected), name
        made: dict[str, Any] = {name: False} if name in ("doppler", "noise") else {}
        processing = replace(Processing(), intra_chirp_motion=True, **made)
        assert ALL.without(name).settings(settings).processing == processing, name
    # What the user left out stays out.
    few = ChainSettings(TraceSettings(depth=1, specular=False, diffuse=False), Processing(noise=False))
    assert ALL.settings(few).trace == replace(few.trace, refraction=True, diffraction=True, corners=True)
    assert not ALL.settings(few).processing.noise


def test_without_its_pattern_an_element_has_the_gain_of_boresight_everywhere() -> None:
    front_end, directions = FrontEnd(), np.array([[1.0, 0.0, 0.0], [1.0, 2.0, -0.5], [0.0, 0.0, -1.0]])
    assert ALL.settings(ChainSettings()).antenna_pattern
    assert not ALL.without("antenna_pattern").settings(ChainSettings()).antenna_pattern
    flat = front_end.with_boresight_gain()
    for before, after in ((front_end.tx_pattern, flat.tx_pattern), (front_end.rx_pattern, flat.rx_pattern)):
        assert after.power_gain(directions) == pytest.approx(np.full(3, before.power_gain(directions[0])), rel=1e-12)
        assert before.power_gain(directions[2]) < 1e-2 * after.power_gain(directions[2])
    assert flat.transmit_power_dbm == front_end.transmit_power_dbm
