"""Which effects a scene calls for, and why; and which of them each of its frames is made with.

An effect is simulated where leaving it out would change the frame by more than the error budget: the power in a
resolution cell over the peak's for added echoes, the response over its peak for how echoes are formed. It is also where
more than a tenth of the cells above the noise would change, however far below the peak: one strong mirror does not
empty the rest of the picture. The figures of each effect stand in :mod:`datafactory.frame.changes` and
:mod:`datafactory.effects.evidence`.

Effects of the signal are decided by every frame for itself, from its own paths (:mod:`datafactory.frame.needs`). Those
that decide which paths are traced cannot be: the evidence on them was found at a few poses. A frame near one of these
leaves out what was not called for there; every other frame has all that the scene has something for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from datafactory.effects.catalogue import DESCRIPTIONS, NAMES, PATH_EFFECTS, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Evidence, Gathered
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import DealtFrame
from datafactory.frame.defaults import DEFAULT_BUDGET_DB
from datafactory.frame.needs import FRAME_EFFECTS, OCCUPIED_SHARE
from datafactory.scenes.poses import Pose

REACH_M = 2.0
REACH_DEG = 10.0
"""How far a pose may be from one that was looked at, and how far turned, for what was found there to hold. At 8 m and
20 deg an edge called for diffraction, -12 dB of the peak, that a look had done without: see docs/planning.md."""

NEEDS = {"range_migration": "doppler", "intra_chirp_motion": "doppler"}
"""An effect that means nothing without another."""


@dataclass(frozen=True)
class Decision:
    """One effect of a plan.

    :param effect: its name
    :param on: whether it is simulated
    :param reason: why, in words; :param evidence: the figures behind it
    :param loss_db: what leaving it out costs
    """

    effect: str
    on: bool
    reason: str
    evidence: str
    loss_db: float


@dataclass(frozen=True)
class Look:
    """A frame that was looked at.

    :param paths: the effects on paths that it calls for
    """

    frame_id: int
    pose: Pose
    paths: tuple[str, ...]

    def reaches(self, pose: Pose, fastest_mps: float) -> bool:
        """Whether what was found here holds at another pose: the scene looks nearly the same from there.

        :param fastest_mps: of the scene's moving parts [m/s], which stand elsewhere at another time
        """
        moved_m = fastest_mps * abs(pose.time_s - self.pose.time_s)
        distance_m = float(np.linalg.norm(np.subtract(pose.position, self.pose.position)))
        # The trace of the rotation between both is 1 + 2 cos(angle).
        cosine = 0.5 * (float(np.sum(pose.rotation() * self.pose.rotation())) - 1.0)
        return distance_m + moved_m <= REACH_M and cosine >= np.cos(np.radians(REACH_DEG))


@dataclass(frozen=True)
class ByFrame:
    """How a plan is applied to single frames.

    :param looks: frames that were looked at
    :param elsewhere: effects on paths of frames out of their reach: all that the scene has something for
    :param fastest_mps: see :meth:`Look.reaches`
    """

    looks: tuple[Look, ...]
    elsewhere: tuple[str, ...]
    fastest_mps: float = 0.0

    def paths_at(self, pose: Pose) -> frozenset[str]:
        """The effects on paths of a frame at this pose: what any frame within reach was found to call for."""
        near = [look.paths for look in self.looks if look.reaches(pose, self.fastest_mps)]
        return frozenset().union(*near) if near else frozenset(self.elsewhere)


@dataclass(frozen=True)
class EffectPlan:
    """What is simulated of one scene, and why.

    :param scene: its name; :param budget_db: what decided
    :param decisions: one an effect, in the order of the chain: of the frames that were looked at, all together
    :param shares: effect -> (power share, share of the occupied cells), for the picture
    :param by_frame: None where all frames have the effects that the user chose
    """

    scene: str
    budget_db: float
    decisions: tuple[Decision, ...]
    shares: Mapping[str, tuple[float, float]]
    by_frame: ByFrame | None = None

    @property
    def effects(self) -> EffectSet:
        return EffectSet.of({item.effect for item in self.decisions if item.on})

    def effects_at(self, pose: Pose | None) -> EffectSet:
        """The effects that a frame at this pose may have: of those on the signal its own paths then choose.

        :param pose: None where the frame's paths were traced before, which settled what concerns them
        """
        if self.by_frame is None:
            return self.effects
        paths = self.by_frame.elsewhere if pose is None else self.by_frame.paths_at(pose)
        return EffectSet.of({*paths, *FRAME_EFFECTS})

    def settings(self, settings: ChainSettings, pose: Pose | None) -> ChainSettings:
        """How a frame at this pose is made.

        :param settings: of the run, with every effect; :param pose: see :meth:`effects_at`
        """
        chosen = self.effects_at(pose).settings(settings)
        return chosen if self.by_frame is None else replace(chosen, budget_db=self.budget_db)

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.scene,
            "budget_db": self.budget_db,
            "effects": [dict(vars(item)) for item in self.decisions],
            "by_frame": None if self.by_frame is None else asdict(self.by_frame),
        }


def decide(scene: str, evidence: Mapping[str, Evidence], budget_db: float = DEFAULT_BUDGET_DB) -> EffectPlan:
    """The plan that the evidence calls for."""
    on: dict[str, bool] = {}
    decisions = []
    for name in NAMES:
        found = evidence[name]
        wanted = found.change_db > budget_db or found.cell_share > OCCUPIED_SHARE
        needed = NEEDS.get(name)
        on[name] = wanted and (needed is None or on[needed])
        decisions.append(Decision(name, on[name], _reason(name, found, on[name], budget_db), found.text,
                                  round(found.change_db, 1) + 0.0))  # fmt: skip
    shares = {name: (evidence[name].power_share, evidence[name].cell_share) for name in NAMES}
    return EffectPlan(scene, budget_db, tuple(decisions), shares)


def plan_by_frame(
    scene: str, found: Gathered, looked_at: Sequence[DealtFrame], budget_db: float, fastest_mps: float
) -> EffectPlan:
    """The plan that the evidence calls for, with what each frame that was looked at calls for.

    :param looked_at: the frames that the evidence is on
    """
    looks = []
    for frame, evidence in zip(looked_at, found.frames, strict=True):
        needed = decide(scene, evidence, budget_db).effects.names
        looks.append(Look(frame.frame_id, frame.where, tuple(name for name in needed if name in PATH_EFFECTS)))
    elsewhere = tuple(name for name in PATH_EFFECTS if name not in found.absent)
    plan = decide(scene, found.evidence, budget_db)
    return replace(plan, by_frame=ByFrame(tuple(looks), elsewhere, fastest_mps))


def by_choice(scene: str, effects: EffectSet) -> EffectPlan:
    """The plan of a user who said which."""
    decisions = tuple(Decision(name, getattr(effects, name), "as asked for", "--effects", 0.0) for name in NAMES)
    return EffectPlan(scene, DEFAULT_BUDGET_DB, decisions, {})


def _reason(name: str, found: Evidence, on: bool, budget_db: float) -> str:
    what = DESCRIPTIONS[name].split(";")[0]
    if found.change_db <= FLOOR_DB:
        return found.text
    level = f"{found.change_db:.1f} dB of the peak"
    if on and found.change_db <= budget_db:
        return f"{what}: {level}, but {100.0 * found.cell_share:.0f} % of the cells above the noise"
    if on:
        return f"{what}: {level}, above {budget_db:g} dB"
    if found.change_db > budget_db or found.cell_share > OCCUPIED_SHARE:
        return f"{what}: means nothing without {NEEDS[name]}"
    return f"{what}: no more than {level}, within {budget_db:g} dB"
