"""A plan with what it costs and, where asked, the proof that it keeps its promise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from datafactory.effects.catalogue import NAMES
from datafactory.effects.plan import EffectPlan
from datafactory.effects.proof import Proof, prove
from datafactory.effects.timing import Advance, costs
from datafactory.frame.chain import ChainSettings
from datafactory.frame.prepared import Sample
from shared.radar import Radar


@dataclass(frozen=True)
class PricedPlan:
    """A plan, what each effect costs, and how far its frames are from those of every effect.

    :param seconds: effect -> processor seconds a frame; zeros where they were not measured
    """

    plan: EffectPlan
    seconds: Mapping[str, float]
    proof: Proof | None

    def to_json(self) -> dict[str, Any]:
        """What ``datafactory plan --json`` prints."""
        document = self.plan.to_json()
        for item in document["effects"]:
            item["cost_seconds"] = round(self.seconds[item["effect"]], 3)
        if self.proof is not None:
            document["proof"] = {name: round(value, 3) for name, value in vars(self.proof).items()}
        return document


def price(
    sample: Sample,
    plan: EffectPlan,
    radar: Radar,
    settings: ChainSettings,
    times: bool,
    proven: bool,
    advance: Advance = lambda done, total, label: None,
) -> PricedPlan:
    """Price a plan on the first of its frames; a scene without a frame in the run costs nothing.

    :param settings: of the run, with every effect
    :param times: measure what each effect costs; :param proven: simulate a frame both ways
    """
    seconds, proof = dict.fromkeys(NAMES, 0.0), None
    if sample.frames and times:
        seconds = costs(sample.frames[0], sample.scene, radar, settings, plan, advance)
    if sample.frames and proven:
        frame = sample.frames[0]
        proof = prove(frame, sample.scene, radar, settings, plan.settings(settings, frame.pose))
    return PricedPlan(plan, seconds, proof)
