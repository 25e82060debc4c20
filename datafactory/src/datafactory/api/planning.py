"""Which effects the frames of a run call for: :func:`datafactory.plan`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from datafactory.accuracy.proof import Proof, costs, prove
from datafactory.api.asking import materials_of, order_of
from datafactory.api.options import OrderOptions, PlanOptions
from datafactory.api.turns import in_turn
from datafactory.effects.plan import EffectPlan, FramePlan, plan_of_frame, plan_of_scene
from datafactory.frame.chain import SceneSource
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.portions import Job
from datafactory.run.preparation import prepare
from shared.physics.errors import Told
from shared.processes.declared import common, taking

DEAREST = 5
"""Effects whose price is told. What they take together is not their sum: they share work."""
MOST_FRAMES = 8
"""Frames of a scene whose decisions are told, spread over the run; each costs about as much as one that is rendered."""


@dataclass(frozen=True)
class ScenePlan(Told):
    """What is simulated of one scene, why, what each effect costs and contributes.

    :param plan: of all frames that were looked at
    :param frames: their number
    :param seconds: effect -> processor seconds of a frame; empty where they were not measured
    :param proof: how far a frame as it decides is from that of every effect, where asked for
    """

    plan: EffectPlan
    frames: int
    seconds: Mapping[str, float]
    proof: Proof | None

    def __str__(self) -> str:
        """The effects that are on and off; the reasons stand in ``plan.decisions``."""
        decided = self.plan.decisions
        on, off = ([item.effect for item in decided if item.on is wanted] for wanted in (True, False))
        counted = f"{self.frames} frame{'' if self.frames == 1 else 's'} looked at"
        told = [
            f"plan of {self.plan.scene}: {counted}, error budget {self.plan.budget_db:g} dB",
            f"on: {', '.join(on) or 'none'}",
            f"off: {', '.join(off) or 'none'}",
        ]
        if self.seconds:
            dear = sorted(((taken, name) for name, taken in self.seconds.items() if taken >= 0.005), reverse=True)
            each = ", ".join(f"{name} {taken:.2f}" for taken, name in dear[:DEAREST])
            told.append(f"dearest, in processor seconds a frame: {each or 'none'}")
        return "\n".join(told)

    def to_json(self) -> dict[str, Any]:
        """What ``datafactory plan --json`` prints."""
        document = self.plan.to_json()
        for item in document["effects"]:
            item["cost_seconds"] = round(self.seconds[item["effect"]], 3) if self.seconds else None
        if self.proof is not None:
            document["proof"] = {name: round(value, 3) for name, value in vars(self.proof).items()}
        return document


@taking(PlanOptions)
@in_turn
def plan(asked: PlanOptions) -> tuple[ScenePlan, ...]:
    """Say which effects the frames of ``render`` with the same arguments decide for, and why.

    >>> plan("scenes/tiny.usda")[0].plan.effects.names  # doctest: +SKIP

    :returns: one for each scene; ``to_json()`` is what ``datafactory plan --json`` prints
    :raises InputError: anything wrong with the arguments or their files
    """
    order = order_of(common(OrderOptions, asked), synthesis=asked.times or asked.prove)
    table = materials_of(asked.materials)
    select_variant(order.settings.device)
    set_threads(1)
    with threadpool_limits(limits=1):
        job = prepare(order, table, asked.announce).job
        return tuple(_planned(job, index, order.budget_db, asked) for index in range(len(job.scenes)))


def spread(frame_ids: Sequence[int]) -> Sequence[int]:
    """At most ``MOST_FRAMES`` of them, at even distances, the first among them."""
    return frame_ids[:: max(1, math.ceil(len(frame_ids) / MOST_FRAMES))]


def _planned(job: Job, index: int, budget_db: float, asked: PlanOptions) -> ScenePlan:
    """What frames of one scene decide; a scene without a frame in the run costs nothing."""
    scene, found = job.scenes[index], list[FramePlan]()
    frames = [SceneSource(job.deal.frame(n), scene, job.of_scenes) for n in spread(job.deal.frames_of(index))]
    for number, source in enumerate(frames):
        asked.progress(f"frames of {scene.name}", number, len(frames))
        found.append(plan_of_frame(source, job.radar))
    told = plan_of_scene(scene.name, found, budget_db)
    seconds = costs(frames[0], job.radar, told, asked.progress) if frames and asked.times else {}
    proof = prove(frames[0], job.radar) if frames and asked.prove else None
    return ScenePlan(told, len(frames), seconds, proof)
