"""``datafactory plan`` and ``accuracy``: what effects and accuracy cost."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rich.table import Table

from datafactory.api.options import AccuracyOptions, OrderOptions, PlanCommandOptions, PlanOptions
from datafactory.defaults import DEFAULT_FRAMES, IMAGE_BATCH
from shared.cli.console import plain_console, table
from shared.cli.options import asking
from shared.physics.errors import InputError
from shared.processes.declared import common

PLAN_WIDTH = 150
ACCURACY_WIDTH = 120
"""Columns that the tables of plan and accuracy need; a narrower terminal wraps their lines rather than their cells."""


@asking(PlanCommandOptions)
def plan(
    asked: PlanCommandOptions,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON and nothing else.")] = False,
) -> None:
    """Say which effects will be simulated, why, what each costs and what leaving it out would cost.

    With the scenes, frames, split and seed of a `datafactory render` these are frames of that run.
    """
    from datafactory.api.planning import plan as plan_of
    from datafactory.effects.plan import draw
    from shared.cli.progress import bars
    from shared.dataset.locations import local
    from shared.dataset.writing import require_folder, write_json

    if (out := asked.out) is not None:
        require_folder(local(out, "--out"), "--out")
    console = plain_console(stderr=as_json)
    with bars(console, transient=True) as advance:
        planned = plan_of(**{**vars(common(PlanOptions, asked)), "announce": console.print, "progress": advance})
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for number, item in enumerate(planned):
            name = "plan" if len(planned) == 1 else f"plan-{number}-{item.plan.scene}"
            write_json(out / f"{name}.json", item.to_json())
            draw(item.plan, item.seconds, out / f"{name}.png")
            console.print(f"wrote {out / name}.json and {out / name}.png")
    documents = [item.to_json() for item in planned]
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2))
        return
    for item, document in zip(planned, documents, strict=True):
        plain_console(narrowest=PLAN_WIDTH).print(_effects(document))
        looked = f"{item.frames} frame{'' if item.frames == 1 else 's'} of {item.plan.scene} looked at"
        console.print(f"{looked}; every frame of a run decides for itself")
        if item.proof is not None:
            console.print(item.proof.sentence())


def _effects(document: dict[str, Any]) -> Table:
    rows = []
    for item in document["effects"]:
        nothing = item["loss_db"] <= -200.0
        rows.append(
            (
                item["effect"], "on" if item["on"] else "off", item["reason"], "" if nothing else item["evidence"],
                "" if item["cost_seconds"] is None else f"{item['cost_seconds']:.2f}",
                "" if nothing else f"{item['loss_db']:.1f}",
            )
        )  # fmt: skip
    title = f"{document['scene']}: error budget {document['budget_db']:g} dB"
    return table(title, ("effect", "", "why", "evidence", "cost [s/frame]", "loss [dB]"), rows)


@asking(AccuracyOptions)
def accuracy(asked: AccuracyOptions) -> None:
    """Show what accuracy costs in time: every approximation as a knob with its price and its error."""
    from datafactory.accuracy import report, study
    from datafactory.accuracy.knobs import Sample
    from datafactory.api.asking import materials_of, order_of
    from datafactory.paths.backend import set_threads
    from datafactory.run.preparation import prepare
    from shared.cli.progress import bars
    from shared.dataset.locations import local
    from shared.dataset.writing import require_folder

    scene, out, quick = asked.scene, asked.out, asked.quick
    if scene is None:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME")
    console = plain_console()
    # As many frames are drawn as of a run, of which the first are measured; rays and depth are varied.
    drawn = DEFAULT_FRAMES if asked.poses is None else None
    order = order_of(common(OrderOptions, asked, scenes=scene, frames=drawn, rays=None))
    menu = study.menu_of_study(quick, asked.rays, asked.most_rays, order.radar)
    require_folder(local(out, "--out"), "--out")
    set_threads(1)
    job = prepare(order, materials_of(asked.materials), console.print).job
    count = min(1 if quick else asked.frames, len(job.deal))
    out.mkdir(parents=True, exist_ok=True)
    samples = [Sample(job.deal.frame(frame_id), job.scenes[0], order) for frame_id in range(count)]
    batch = 1 if quick else IMAGE_BATCH
    with bars(console) as progress:
        rows = study.study(samples, menu, asked.repeats, batch, progress)
    wide = plain_console(narrowest=ACCURACY_WIDTH)
    wide.print(table(f"What accuracy costs: {scene}", report.HEADINGS, report.table_rows(rows)))
    for line in report.explanation(menu.effort):
        console.print(line)
    title = (
        f"{scene}: {count} frame{'s' if count > 1 else ''}, seed {order.seed}, radar {order.radar.name}, "
        f"{menu.usual_rays} rays, images in batches of {batch}"
    )
    for path in report.write(rows, title, out):
        console.print(f"wrote {path}")
