"""Which effects a scene calls for, and why.

An effect is simulated where leaving it out would change the frame by more than the error budget: the power in a
resolution cell over the peak's for added echoes, the response over its peak for how echoes are formed. It is also where
more than a tenth of the cells above the noise would change, however far below the peak: one strong mirror does not
empty the rest of the picture. The figures of each effect stand in :mod:`datafactory.effects.changes` and
:mod:`datafactory.effects.evidence`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from datafactory.effects.catalogue import DESCRIPTIONS, NAMES, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Evidence
from datafactory.frame.defaults import DEFAULT_BUDGET_DB

OCCUPIED_SHARE = 0.1
"""Of the cells above the noise; those that change by more than half a decibel count."""

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
class EffectPlan:
    """What is simulated of one scene, and why.

    :param scene: its name; :param budget_db: what decided
    :param decisions: one an effect, in the order of the chain
    :param shares: effect -> (power share, share of the occupied cells), for the picture
    """

    scene: str
    budget_db: float
    decisions: tuple[Decision, ...]
    shares: Mapping[str, tuple[float, float]]

    @property
    def effects(self) -> EffectSet:
        return EffectSet.of({item.effect for item in self.decisions if item.on})

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.scene,
            "budget_db": self.budget_db,
            "effects": [dict(vars(item)) for item in self.decisions],
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
