"""Which effects a frame is made with, by where it stands."""

from __future__ import annotations

import pytest

from datafactory.effects.catalogue import NAMES, PATH_EFFECTS, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Evidence, Gathered
from datafactory.effects.plan import REACH_DEG, REACH_M, by_choice, plan_by_frame
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import Deal
from datafactory.frame.needs import FRAME_EFFECTS
from datafactory.run.planning import MOST_LOOKS, worth_looking_at
from datafactory.scenes.poses import Pose

HERE = Pose((0.0, 0.0, 0.5))
BESIDE = Pose((0.0, 0.9 * REACH_M, 0.5))
FAR = Pose((200.0, 0.0, 0.5))


def evidence(**change_db: float) -> dict[str, Evidence]:
    return {name: Evidence(change_db.get(name, FLOOR_DB), "", 0.0, 0.0) for name in NAMES}


def plan(*seen: dict[str, Evidence], poses: tuple[Pose, ...] = (HERE,), fastest_mps: float = 0.0):
    found = Gathered(absent={"refraction": "no material lets a wave through"}, frames=seen)
    frames = [Deal(scenes=1, poses=poses).frame(index) for index in range(len(poses))]
    return plan_by_frame("scene", found, frames, -30.0, fastest_mps)


def paths_of(effects: EffectSet) -> set[str]:
    return set(effects.names) & set(PATH_EFFECTS)


def test_a_frame_near_one_that_was_looked_at_leaves_out_what_that_did_without() -> None:
    found = plan(evidence(specular=0.0, diffuse=-12.0, multi_bounce=-44.0))
    for pose in (HERE, BESIDE, Pose((0.0, 0.0, 0.5), yaw_deg=0.9 * REACH_DEG)):
        assert paths_of(found.effects_at(pose)) == {"specular", "diffuse"}


@pytest.mark.parametrize(
    "pose",
    [FAR, Pose((1.01 * REACH_M, 0.0, 0.5)), Pose((0.0, 0.0, 0.5), yaw_deg=1.1 * REACH_DEG),
     Pose((0.0, 0.0, 0.5), yaw_deg=180.0), Pose((0.0, 0.0, 0.5), pitch_deg=-1.1 * REACH_DEG)],
)  # fmt: skip
def test_every_other_frame_has_all_that_the_scene_has_something_for(pose: Pose) -> None:
    found = plan(evidence(specular=0.0))
    assert paths_of(found.effects_at(pose)) == set(PATH_EFFECTS) - {"refraction"}


def test_where_things_move_an_evidence_ages() -> None:
    later = Pose((0.0, 0.0, 0.5), time_s=2.0)
    assert paths_of(plan(evidence(specular=0.0)).effects_at(later)) == {"specular"}
    moving = plan(evidence(specular=0.0), fastest_mps=0.6 * REACH_M)
    assert "diffraction" in moving.effects_at(later).names


def test_of_two_frames_within_reach_either_may_call_for_an_effect() -> None:
    found = plan(evidence(specular=0.0), evidence(diffraction=-5.0), poses=(HERE, BESIDE))
    assert paths_of(found.effects_at(HERE)) == {"specular", "diffraction"}


def test_effects_of_the_signal_are_left_to_the_frame() -> None:
    """Whatever the frames that were looked at did without."""
    found = plan(evidence(specular=0.0))
    for pose in (HERE, FAR, None):
        assert set(FRAME_EFFECTS) <= set(found.effects_at(pose).names)
        assert found.settings(ChainSettings(), pose).budget_db == -30.0


def test_what_a_user_chose_holds_everywhere() -> None:
    chosen = by_choice("scene", EffectSet.of({"diffuse", "noise"}))
    for pose in (HERE, FAR, None):
        assert chosen.effects_at(pose).names == ("diffuse", "noise")
        assert chosen.settings(ChainSettings(), pose).budget_db is None


def test_looks_go_where_frames_stand() -> None:
    standing = [HERE] * 10
    drive = [Pose((20.0 + 0.15 * REACH_M * step, 0.0, 0.5)) for step in range(40)]
    assert worth_looking_at(standing, 0.0) == [0]
    looks = worth_looking_at(standing + drive, 0.0)
    assert len(looks) == MOST_LOOKS
    reached = {index for index, pose in enumerate(drive) for look in looks
               if abs(pose.position[0] - (standing + drive)[look].position[0]) <= REACH_M}  # fmt: skip
    assert len(reached) >= 26  # two looks of 13 frames each


def test_a_second_look_has_to_pay() -> None:
    few = [Pose((100.0 * step, 0.0, 0.5)) for step in range(5)]
    assert worth_looking_at(few, 0.0) == [0]
    assert worth_looking_at([], 0.0) == []
