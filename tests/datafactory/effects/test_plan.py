"""From evidence to a plan, and the plan's contract."""

from __future__ import annotations

import json
from pathlib import Path

from datafactory.effects import timing
from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Evidence
from datafactory.effects.picture import draw
from datafactory.effects.plan import by_choice, decide
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import DealtFrame
from datafactory.frame.defaults import DEFAULT_BUDGET_DB
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from shared.radar import Radar


def evidence(**change_db: float) -> dict[str, Evidence]:
    """Evidence of a scene that has nothing but what is named here."""
    return {name: Evidence(change_db.get(name, FLOOR_DB), f"figures of {name}", 0.25, 0.05) for name in NAMES}


def test_an_effect_is_on_where_it_changes_more_than_the_budget() -> None:
    found = evidence(specular=0.0, diffuse=-29.9, multi_bounce=-30.0, diffraction=-30.1)
    assert decide("scene", found).effects.names == ("specular", "diffuse")
    assert decide("scene", found, -40.0).effects.names == ("specular", "diffuse", "multi_bounce", "diffraction")
    assert DEFAULT_BUDGET_DB == -30.0


def test_an_effect_is_on_where_it_fills_cells_however_far_below_the_peak() -> None:
    found = evidence(specular=0.0, diffuse=-45.0, diffraction=-45.0)
    found["diffuse"] = Evidence(-45.0, "", 0.01, 0.11)
    found["diffraction"] = Evidence(-45.0, "", 0.01, 0.09)
    plan = decide("scene", found)
    assert plan.effects.names == ("specular", "diffuse")
    assert "11 % of the cells" in plan.decisions[1].reason


def test_motion_within_the_frame_means_nothing_without_doppler() -> None:
    frozen = decide("scene", evidence(doppler=-50.0, range_migration=-10.0, intra_chirp_motion=-10.0))
    assert frozen.effects.names == ()
    reasons = {item.effect: item.reason for item in frozen.decisions}
    assert "doppler" in reasons["range_migration"]
    assert "doppler" in reasons["intra_chirp_motion"]
    moving = decide("scene", evidence(doppler=-5.0, range_migration=-10.0, intra_chirp_motion=-40.0))
    assert moving.effects.names == ("doppler", "range_migration")


def test_a_plan_in_json_is_the_contract_s(tmp_path: Path) -> None:
    plan = decide("street", evidence(diffuse=-3.14, near_field=-0.001, noise=0.0), -20.0)
    document = json.loads(json.dumps(plan.to_json()))
    assert document["scene"] == "street"
    assert document["budget_db"] == -20.0
    assert [item["effect"] for item in document["effects"]] == list(NAMES)
    for item in document["effects"]:
        assert set(item) == {"effect", "on", "reason", "evidence", "loss_db"}  # cost_seconds joins them in the CLI
        assert isinstance(item["on"], bool)
        assert item["reason"]
        assert "\n" not in item["reason"] + item["evidence"]
        assert item["evidence"] == f"figures of {item['effect']}"
    levels = {item["effect"]: item["loss_db"] for item in document["effects"]}
    assert levels["diffuse"] == -3.1
    assert str(levels["near_field"]) == "0.0"  # and not the minus nothing that rounding leaves
    assert plan.effects.names == ("diffuse", "near_field", "noise")


def test_a_reason_states_the_figure_and_the_budget() -> None:
    plan = decide("scene", evidence(diffuse=-12.34, diffraction=-44.4))
    reasons = {item.effect: item.reason for item in plan.decisions}
    assert "-12.3 dB" in reasons["diffuse"]
    assert "above -30 dB" in reasons["diffuse"]
    assert "-44.4 dB" in reasons["diffraction"]
    assert "within -30 dB" in reasons["diffraction"]
    assert reasons["refraction"] == "figures of refraction"


def test_a_user_s_own_choice_is_a_plan_too() -> None:
    chosen = EffectSet.of({"diffuse", "noise"})
    plan = by_choice("street", chosen)
    assert plan.effects == chosen
    assert [item.effect for item in plan.decisions] == list(NAMES)
    assert {item.evidence for item in plan.decisions} == {"--effects"}


def test_the_picture_of_a_plan_is_a_png_of_its_figures(tmp_path: Path) -> None:
    seconds = dict.fromkeys(NAMES, 0.1)
    draw(decide("one", evidence(diffuse=-3.0)), seconds, tmp_path / "one.png")
    draw(decide("one", evidence(diffuse=-60.0)), seconds, tmp_path / "other.png")
    one, other = ((tmp_path / name).read_bytes() for name in ("one.png", "other.png"))
    assert one.startswith(b"\x89PNG")
    assert one != other


def test_costs_are_differences_of_frames(monkeypatch) -> None:
    """By a clock of 1 s a frame and 0.5 s an effect, each costs half a second, and absent ones nothing."""
    asked: list[ChainSettings] = []

    def frame_seconds(frame: object, scene: object, radar: object, settings: ChainSettings) -> float:
        asked.append(settings)
        return 1.0 + 0.5 * len(of_settings[settings].names)

    plan = decide("scene", evidence(specular=0.0, diffuse=-50.0, noise=0.0))
    found, base = ("specular", "diffuse", "noise"), ChainSettings()
    sets = [
        plan.effects.without(name) if getattr(plan.effects, name) else plan.effects.with_also(name) for name in found
    ]
    of_settings = {effects.settings(base): effects for effects in (ALL, plan.effects, *sets)}
    monkeypatch.setattr(timing, "frame_seconds", frame_seconds)
    steps: list[tuple[int, int, str]] = []
    frame, scene = a_frame()
    result = timing.costs(frame, scene, Radar(), base, plan, lambda *step: steps.append(step))
    assert result == {name: 0.5 if name in found else 0.0 for name in NAMES}
    assert [step[0] for step in steps] == list(range(steps[0][1]))
    assert ALL.settings(base) in asked


def a_frame() -> tuple[DealtFrame, PreparedScene]:
    """Of an empty scene; nothing is traced."""
    materials = load_materials().map_materials([])
    scene = PreparedScene("empty", "none", MergedScene((), ()), materials)
    return DealtFrame(0, "scene", "train", 1, scene=0, pose=Pose((0.0, 0.0, 0.5))), scene
