"""Which effects a scene calls for: :func:`datafactory.plan`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from threadpoolctl import threadpool_limits

from datafactory.api.asking import (
    Announce,
    MaterialsLike,
    PosesLike,
    Progress,
    RadarLike,
    SceneLike,
    materials_of,
    order_of,
    silent,
)
from datafactory.effects.price import PricedPlan, price
from datafactory.frame.defaults import DEFAULT_FRAMES
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.defaults import CPU
from datafactory.run.planning import how_applied
from datafactory.run.preparation import prepare
from shared.processes.defaults import DEFAULT_RADAR


@dataclass(frozen=True)
class ScenePlan(PricedPlan):
    """What is simulated of one scene, why, what each effect costs [s a frame] and contributes [dB].

    :param applied: in words, how the run's frames follow the plan
    """

    applied: str = ""


def plan(
    scenes: SceneLike | Sequence[SceneLike],
    *,
    radar: RadarLike = DEFAULT_RADAR,
    frames: int = DEFAULT_FRAMES,
    poses: PosesLike | None = None,
    seed: int = 0,
    split: str | None = None,
    materials: MaterialsLike | None = None,
    rays: int | None = None,
    depth: int | None = None,
    error_budget: float | None = None,
    times: bool = False,
    prove: bool = False,
    device: str = CPU,
    announce: Announce = silent,
    progress: Progress = silent,
) -> tuple[ScenePlan, ...]:
    """Say which effects will be simulated of each scene; the plan of ``render`` with the same arguments.

    >>> plan("scenes/tiny.usda")[0].plan.effects.names  # doctest: +SKIP

    :param error_budget: what leaving an effect out may change [dB of the peak]; -30 by default
    :param times: measure what each effect costs in processor time
    :param prove: simulate one frame as planned and with every effect, and compare
    :param device: as of :func:`datafactory.render`; the plan of a run is made on the run's own
    :returns: one for each scene; ``to_json()`` is what ``datafactory plan --json`` prints
    :raises InputError: anything wrong with the arguments or their files
    """
    order = order_of(
        scenes, radar=radar, frames=frames, poses=poses, seed=seed, split=split, rays=rays, depth=depth,
        error_budget=error_budget, device=device, synthesis=times or prove,
    )  # fmt: skip
    table = materials_of(materials)
    select_variant(order.settings.device)
    set_threads(1)
    with threadpool_limits(limits=1):
        prepared = prepare(order, table, announce, partial(progress, "planning"))
        priced = [
            price(
                sample, found, order.radar, order.settings, times, prove,
                lambda done, total, label: progress(label, done, total),
            )
            for sample, found in zip(prepared.samples, prepared.plans, strict=True)
        ]  # fmt: skip
    return tuple(
        ScenePlan(item.plan, item.seconds, item.proof, how_applied(prepared.deal, number, item.plan))
        for number, item in enumerate(priced)
    )
