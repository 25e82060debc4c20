"""``datafactory plan``: which effects a scene calls for, why, and what each costs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from datafactory.cli import options
from datafactory.effects.picture import draw
from datafactory.effects.plan import DEFAULT_BUDGET_DB
from datafactory.effects.proof import prove
from datafactory.effects.timing import costs
from datafactory.frame.chain import Processing
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.solver import TraceSettings
from datafactory.run.order import Order
from datafactory.run.sources import scene_plan
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from shared.dataset.writing import write_json
from shared.radar import load_radar

SAMPLED = 3
"""Poses drawn where none are given."""
TABLE_WIDTH = 150


def plan(
    scene: Annotated[str, typer.Option(help="USD, Mitsuba XML or mesh file, or sionna:NAME.", show_default=False)],
    poses: options.Poses = None,
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
    rays: options.Rays = 200_000,
    depth: options.Depth = 2,
    prove_it: Annotated[
        bool, typer.Option("--prove", help="Simulate one frame as planned and with every effect, and compare.")
    ] = False,
    times: Annotated[bool, typer.Option("--times/--no-times", help="Measure what each effect costs in time.")] = True,
) -> None:
    """Say which effects will be simulated, why, what each costs and what leaving it out would cost."""
    console = Console(soft_wrap=True, highlight=False, stderr=as_json)
    given = read_poses(poses) if poses else ()
    order = Order(
        radar=load_radar(radar), scenes=(scene,), frames=0 if given else SAMPLED, poses=given, seed=seed,
        budget_db=error_budget, trace=TraceSettings(rays=rays, depth=depth),
    )  # fmt: skip
    select_variant()
    set_threads(1)
    columns = (TextColumn("{task.description:24s}"), BarColumn(), MofNCompleteColumn())
    with threadpool_limits(limits=1), Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("looking", total=None)
        probe, found, evidence = scene_plan(
            order, load_materials(materials), lambda line: console.print(line, markup=False)
        )
        seconds = dict.fromkeys(evidence, 0.0)
        if times:
            seconds = costs(
                probe, found.effects, evidence, Processing(),
                lambda done, total, label: progress.update(task, completed=done, total=total, description=label),
            )  # fmt: skip
        proof = prove(probe, found.effects) if prove_it else None
    document = found.to_json()
    if proof is not None:
        document["proof"] = {name: round(value, 3) for name, value in vars(proof).items()}
    for item in document["effects"]:
        item["cost_seconds"] = round(seconds[item["effect"]], 3)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "plan.json", document)
        draw(found, seconds, out / "plan.png")
    if as_json:
        print(json.dumps(document, indent=2))
        return
    _table(document, console)
    if proof is not None:
        console.print(
            f"against --effects all: power in a cell {proof.power_db:.1f} dB, input image {proof.input_db:.1f} dB, "
            f"truth image {proof.truth_db:.1f} dB of the peak; {proof.planned_seconds:.2f} s a frame instead of "
            f"{proof.all_seconds:.2f} s"
        )
    if out is not None:
        console.print(f"wrote {out / 'plan.json'} and {out / 'plan.png'}", markup=False)


def _table(document: dict[str, Any], console: Console) -> None:
    shown = Table(title=f"{document['scene']}: error budget {document['budget_db']:g} dB", title_justify="left")
    for heading in ("effect", "", "why", "evidence", "cost [s/frame]", "loss [dB]"):
        shown.add_column(heading, justify="right" if "[" in heading else "left")
    for item in document["effects"]:
        nothing = item["loss_db"] <= -200.0
        shown.add_row(
            item["effect"], "on" if item["on"] else "off", item["reason"], "" if nothing else item["evidence"],
            f"{item['cost_seconds']:.2f}", "" if nothing else f"{item['loss_db']:.1f}",
        )  # fmt: skip
    Console(width=max(console.width, TABLE_WIDTH), highlight=False).print(shown)
