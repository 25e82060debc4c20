"""The plan of every scene of a run: from frames of the run itself, its evidence kept in the user's cache."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from datafactory.effects.evidence import Gathered, gather
from datafactory.effects.plan import EffectPlan, Look, by_choice, plan_by_frame
from datafactory.frame.deal import Deal, spread
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.cache import Announce, cached, user_cache
from datafactory.run.order import Order
from datafactory.scenes.poses import Pose

MOST_LOOKS = 3
"""Frames of a scene that are looked at; each costs about one trace, less than a frame."""
WORTH_A_LOOK = 6
"""Frames that a second or third look must reach beyond the others, so that what it saves in them pays for it."""
CANDIDATES = 200
"""Poses that are weighed against each other, spread over a longer run."""


@dataclass
class Looking:
    """How far the looking has come, over all scenes.

    :param total: frames to look at; :param looked: takes frames looked at, and ``total``
    """

    total: int
    looked: Callable[[int, int], None] = lambda done, total: None
    done: int = 0

    def advance(self, count: int = 1) -> None:
        """More frames were looked at."""
        self.done += count
        self.looked(self.done, self.total)


def sample_of(deal: Deal, number: int, scene: PreparedScene) -> Sample:
    """The frames of a scene that its plan is made from.

    Poses that are drawn lie all over the free ground, none near another: one is looked at. Of given ones, those that
    most frames stand near (:meth:`datafactory.effects.plan.Look.reaches`), the second and third only where that pays.

    :param number: of the scene among the run's
    """
    frame_ids = deal.frames_of(number)
    poses = [deal.pose_of(frame_id) for frame_id in frame_ids]
    if None in poses:
        return Sample(scene, tuple(deal.frame(frame_id) for frame_id in frame_ids[:1]))
    chosen = sorted(worth_looking_at([pose for pose in poses if pose is not None], scene.merged.fastest_mps))
    return Sample(scene, tuple(deal.frame(frame_ids[index]) for index in chosen))


def worth_looking_at(poses: Sequence[Pose], fastest_mps: float) -> list[int]:
    """Indices of at most MOST_LOOKS poses, each near most of those that no earlier one is near; the first in doubt."""
    candidates = spread(range(len(poses)), CANDIDATES)
    near = np.array(
        [[Look(0, poses[index], ()).reaches(pose, fastest_mps) for pose in poses] for index in candidates], dtype=bool
    ).reshape(len(candidates), len(poses))
    chosen: list[int] = []
    while len(chosen) < min(MOST_LOOKS, len(poses)):
        counts = near.sum(axis=1)
        best = int(np.argmax(counts))
        if chosen and counts[best] < WORTH_A_LOOK:
            break
        chosen.append(candidates[best])
        near &= ~near[best]
    return chosen


def how_applied(deal: Deal, number: int, plan: EffectPlan) -> str:
    """In words: how many of a scene's frames leave out paths by the plan, and what the others have.

    :param number: of the scene among the run's
    """
    if plan.by_frame is None:
        return "all frames have the effects that were asked for"
    frame_ids = deal.frames_of(number)
    sets = [plan.by_frame.paths_at(deal.frame(frame_id).where) for frame_id in frame_ids]
    everything = frozenset(plan.by_frame.elsewhere)
    fewer = sum(paths != everything for paths in sets)
    return (
        f"{fewer} of {len(sets)} frames leave out paths that frames near them were found to do without; the others "
        f"have all that the scene has something for: {', '.join(plan.by_frame.elsewhere)}. Effects of the signal are "
        "decided by each frame from its own paths"
    )


def evidence_on(sample: Sample, order: Order, announce: Announce, looking: Looking) -> Gathered:
    """The evidence on one scene, measured once."""
    inputs = {
        "scene": sample.scene.content,
        "materials": sample.scene.materials.to_json(),
        "radar": order.radar.model_dump(mode="json"),
        "frames": [[frame.seed, asdict(frame.where)] for frame in sample.frames],
        "settings": asdict(order.settings),
    }

    def measure(_: object) -> Gathered:
        looking.advance(0)
        select_variant(order.settings.device)
        set_threads(1)
        with threadpool_limits(limits=1):
            return gather(sample, order.radar, order.settings, looking.advance)

    return cached(user_cache() / "effects", inputs, Gathered, measure, announce)


def plan_of(order: Order, sample: Sample, announce: Announce, looking: Looking) -> EffectPlan:
    """What is simulated of one scene: what was asked for, or what its own frames call for."""
    name = sample.scene.name
    if order.effects is not None:
        return by_choice(name, order.effects)
    found = evidence_on(sample, order, announce, looking)
    plan = plan_by_frame(name, found, sample.frames, order.budget_db, sample.scene.merged.fastest_mps)
    left_out = ", ".join(item.effect for item in plan.decisions if not item.on) or "nothing"
    simulated = ", ".join(plan.effects.names) or "none"
    where = f"{len(sample.frames)} frame{'s' if len(sample.frames) != 1 else ''} looked at"
    announce(f"{name}: {where}, effects {simulated}; left out {left_out} (datafactory plan says why)")
    return plan
