"""``datafactory trace``: multipath alone, to render radars from later."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.cli.accuracy import make_within_budget
from datafactory.frame.defaults import DEFAULT_BUDGET_DB, DEFAULT_PATTERN
from datafactory.paths.defaults import DEFAULT_RAYS


def trace(
    context: typer.Context,
    out: options.Out,
    scene: options.Scenes = None,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: options.Frames = options.DEFAULT_FRAMES,
    seed: options.Seed = 0,
    poses: options.Poses = None,
    split: options.Split = DEFAULT_PATTERN,
    materials: options.Materials = None,
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = 2,
    effects: options.Effects = "auto",
    error_budget: Annotated[
        float | None,
        typer.Option(
            min=-120.0,
            max=-1.0,
            show_default=False,
            help="Choose rays and depth for this error [dB] of the power in a resolution cell of this radar, e.g. -30, "
            "from a sweep made once; --rays and --depth stay as given.",
        ),
    ] = None,
    workers: options.Workers = 0,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
) -> None:
    """Trace multipath into DIR/paths; `datafactory render --paths DIR` renders any radar from it.

    Of the radar, only its wavelength matters here, and with --error-budget its antennas and resolution.
    """
    from datafactory.effects.catalogue import parse_effects
    from datafactory.run.pipeline import trace_paths
    from datafactory.scenes.materials.table import load_materials

    budget_db = DEFAULT_BUDGET_DB if error_budget is None else error_budget
    order = options.order_of(scene, poses, frames, split, seed, radar, rays, depth, budget_db)
    order = replace(order, effects=parse_effects(effects))
    table = load_materials(materials)
    running = options.Running(out, workers, resume, keep_going)
    if error_budget is None:
        options.run(order, table, running, make=trace_paths)
    else:
        from datafactory.accuracy.budget import menu_for

        menu = menu_for(
            rays if options.stated(context, "rays") else None, depth if options.stated(context, "depth") else None
        ).of_paths()
        make_within_budget(order, table, error_budget, menu, running, make=trace_paths)
    typer.echo(f"next:  datafactory render --paths {out} --out ANOTHER_FOLDER")
