"""``datafactory plan``: which effects frames of a scene decide for, why, and what each costs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datafactory.api.options import PlanOptions
from datafactory.cli.console import shown
from datafactory.cli.options import asking

TABLE_WIDTH = 150


@asking(PlanOptions)
def plan(
    asked: PlanOptions,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON and nothing else.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan.json and plan.png.", show_default=False)
    ] = None,
) -> None:
    """Say which effects will be simulated, why, what each costs and what leaving it out would cost.

    With the scenes, frames, split and seed of a `datafactory render` these are frames of that run.
    """
    from datafactory.api.planning import plan as plan_of
    from datafactory.effects.picture import draw
    from shared.dataset.writing import write_json

    console = Console(soft_wrap=True, highlight=False, stderr=as_json)
    with shown(console, transient=True) as advance:
        told = {"announce": lambda line: console.print(line, markup=False), "progress": advance}
        planned = plan_of(**{**vars(asked), **told})
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for number, item in enumerate(planned):
            name = "plan" if len(planned) == 1 else f"plan-{number}-{item.plan.scene}"
            write_json(out / f"{name}.json", item.to_json())
            draw(item.plan, item.seconds, out / f"{name}.png")
            console.print(f"wrote {out / name}.json and {out / name}.png", markup=False)
    documents = [item.to_json() for item in planned]
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2))
        return
    for item, document in zip(planned, documents, strict=True):
        _table(document, console)
        looked = f"{item.frames} frame{'' if item.frames == 1 else 's'} of {item.plan.scene} looked at"
        console.print(f"{looked}; every frame of a run decides for itself", markup=False)
        if item.proof is not None:
            console.print(item.proof.sentence(), markup=False)


def _table(document: dict[str, Any], console: Console) -> None:
    effects = Table(
        title=escape(f"{document['scene']}: error budget {document['budget_db']:g} dB"), title_justify="left"
    )
    for heading in ("effect", "", "why", "evidence", "cost [s/frame]", "loss [dB]"):
        effects.add_column(escape(heading), justify="right" if "[" in heading else "left")
    for item in document["effects"]:
        nothing = item["loss_db"] <= -200.0
        effects.add_row(
            item["effect"], "on" if item["on"] else "off", item["reason"], "" if nothing else item["evidence"],
            f"{item['cost_seconds']:.2f}", "" if nothing else f"{item['loss_db']:.1f}",
        )  # fmt: skip
    Console(width=max(console.width, TABLE_WIDTH), highlight=False).print(effects)
