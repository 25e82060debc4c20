"""Which effects a scene calls for: :func:`datafactory.plan`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from threadpoolctl import threadpool_limits

from datafactory.api.asking import materials_of, order_of
from datafactory.api.declared import taking
from datafactory.api.options import PlanOptions
from datafactory.effects.price import PricedPlan, price
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.planning import how_applied
from datafactory.run.preparation import prepare


@dataclass(frozen=True)
class ScenePlan(PricedPlan):
    """What is simulated of one scene, why, what each effect costs [s a frame] and contributes [dB].

    :param applied: in words, how the run's frames follow the plan
    """

    applied: str = ""


@taking(PlanOptions)
def plan(asked: PlanOptions) -> tuple[ScenePlan, ...]:
    """Say which effects will be simulated of each scene; the plan of ``render`` with the same arguments.

    >>> plan("scenes/tiny.usda")[0].plan.effects.names  # doctest: +SKIP

    :returns: one for each scene; ``to_json()`` is what ``datafactory plan --json`` prints
    :raises InputError: anything wrong with the arguments or their files
    """
    order = order_of(asked, synthesis=asked.times or asked.prove)
    table = materials_of(asked.materials)
    select_variant(order.settings.device)
    set_threads(1)
    with threadpool_limits(limits=1):
        prepared = prepare(order, table, asked.announce, partial(asked.progress, "planning"))
        priced = [
            price(
                sample, found, order.radar, order.settings, asked.times, asked.prove,
                lambda done, total, label: asked.progress(label, done, total),
            )
            for sample, found in zip(prepared.samples, prepared.plans, strict=True)
        ]  # fmt: skip
    return tuple(
        ScenePlan(item.plan, item.seconds, item.proof, how_applied(prepared.deal, number, item.plan))
        for number, item in enumerate(priced)
    )
