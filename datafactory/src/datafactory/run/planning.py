"""The plan of every scene of a run: from frames of the run itself, its evidence kept in the user's cache."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from threadpoolctl import threadpool_limits

from datafactory.effects.evidence import Evidence, Gathered, gather
from datafactory.effects.plan import EffectPlan, by_choice, decide
from datafactory.frame.deal import Deal, first_middle_last
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.cache import Announce, cached, user_cache
from datafactory.run.order import Order


def sample_of(deal: Deal, number: int, scene: PreparedScene) -> Sample:
    """The frames of a scene that its plan is made from: an effect is needed if any of them needs it.

    :param number: of the scene among the run's
    """
    return Sample(scene, tuple(deal.frame(frame_id) for frame_id in first_middle_last(deal.frames_of(number))))


def evidence_on(sample: Sample, order: Order, announce: Announce) -> Mapping[str, Evidence]:
    """The evidence on one scene, measured once."""
    inputs = {
        "scene": sample.scene.content,
        "materials": sample.scene.materials.to_json(),
        "radar": order.radar.model_dump(mode="json"),
        "frames": [[frame.seed, asdict(frame.where)] for frame in sample.frames],
        "settings": asdict(order.settings),
    }

    def measure(_: object) -> Gathered:
        select_variant()
        set_threads(1)
        with threadpool_limits(limits=1):
            return gather(sample, order.radar, order.settings)

    return cached(user_cache() / "effects", inputs, Gathered, measure, announce).evidence


def plan_of(order: Order, sample: Sample, announce: Announce) -> EffectPlan:
    """What is simulated of one scene: what was asked for, or what its own frames call for."""
    name = sample.scene.name
    if order.effects is not None:
        return by_choice(name, order.effects)
    plan = decide(name, evidence_on(sample, order, announce), order.budget_db)
    left_out = ", ".join(item.effect for item in plan.decisions if not item.on) or "nothing"
    simulated = ", ".join(plan.effects.names) or "none"
    announce(f"{name}: effects {simulated}; left out {left_out} (datafactory plan says why)")
    return plan
