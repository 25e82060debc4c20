"""``datafactory plan``: which effects a scene calls for, why, and what each costs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from datafactory.cli import options
from datafactory.frame.defaults import DEFAULT_BUDGET_DB, DEFAULT_PATTERN
from datafactory.paths.defaults import DEFAULT_RAYS

TABLE_WIDTH = 150


def plan(
    scene: options.Scenes = None,
    poses: options.Poses = None,
    frames: options.Frames = options.DEFAULT_FRAMES,
    split: options.Split = DEFAULT_PATTERN,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan as JSON and nothing else.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for plan.json and plan.png.", show_default=False)
    ] = None,
    error_budget: Annotated[
        float, typer.Option(min=-120.0, max=-1.0, help="What leaving an effect out may cost [dB].")
    ] = DEFAULT_BUDGET_DB,
    seed: options.Seed = 0,
    materials: options.Materials = None,
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = 2,
    prove_it: Annotated[
        bool, typer.Option("--prove", help="Simulate one frame as planned and with every effect, and compare.")
    ] = False,
    times: Annotated[bool, typer.Option("--times/--no-times", help="Measure what each effect costs in time.")] = True,
) -> None:
    """Say which effects will be simulated, why, what each costs and what leaving it out would cost.

    With the scenes, frames, split and seed of a `datafactory render` this is the plan of that run.
    """
    from threadpoolctl import threadpool_limits

    from datafactory.effects.picture import draw
    from datafactory.effects.price import price
    from datafactory.paths.backend import select_variant, set_threads
    from datafactory.run.planning import how_applied
    from datafactory.run.preparation import prepare
    from datafactory.scenes.materials.table import load_materials
    from shared.dataset.writing import write_json

    console = Console(soft_wrap=True, highlight=False, stderr=as_json)
    order = options.order_of(scene, poses, frames, split, seed, radar, rays=rays, depth=depth, budget_db=error_budget)
    select_variant()
    set_threads(1)
    columns = (TextColumn("{task.description:24s}"), BarColumn(), MofNCompleteColumn())
    with threadpool_limits(limits=1), Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("looking", total=None)

        def advance(done: int, total: int, label: str) -> None:
            progress.update(task, completed=done, total=total, description=label)

        prepared = prepare(
            order,
            load_materials(materials),
            lambda line: console.print(line, markup=False),
            lambda done, total: advance(done, total, "looking"),
        )
        priced = [
            price(sample, found, order.radar, order.settings, times, prove_it, advance)
            for sample, found in zip(prepared.samples, prepared.plans, strict=True)
        ]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        for number, item in enumerate(priced):
            name = "plan" if len(priced) == 1 else f"plan-{number}-{item.plan.scene}"
            write_json(out / f"{name}.json", item.to_json())
            draw(item.plan, item.seconds, out / f"{name}.png")
            console.print(f"wrote {out / name}.json and {out / name}.png", markup=False)
    documents = [item.to_json() for item in priced]
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2))
        return
    for number, (item, document) in enumerate(zip(priced, documents, strict=True)):
        _table(document, console)
        console.print(how_applied(prepared.deal, number, item.plan), markup=False)
        if item.proof is not None:
            console.print(item.proof.sentence(), markup=False)


def _table(document: dict[str, Any], console: Console) -> None:
    shown = Table(title=escape(f"{document['scene']}: error budget {document['budget_db']:g} dB"), title_justify="left")
    for heading in ("effect", "", "why", "evidence", "cost [s/frame]", "loss [dB]"):
        shown.add_column(escape(heading), justify="right" if "[" in heading else "left")
    for item in document["effects"]:
        nothing = item["loss_db"] <= -200.0
        shown.add_row(
            item["effect"], "on" if item["on"] else "off", item["reason"], "" if nothing else item["evidence"],
            f"{item['cost_seconds']:.2f}", "" if nothing else f"{item['loss_db']:.1f}",
        )  # fmt: skip
    Console(width=max(console.width, TABLE_WIDTH), highlight=False).print(shown)
