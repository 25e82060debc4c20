"""``datafactory render``: scenes to a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.cli.accuracy import make_within_budget
from datafactory.frame.defaults import DEFAULT_BUDGET_DB, DEFAULT_PATTERN
from datafactory.paths.defaults import DEFAULT_RAYS
from shared.physics.errors import InputError


def render(
    context: typer.Context,
    out: options.Out,
    scene: options.Scenes = None,
    paths: Annotated[
        Path | None, typer.Option(help="Folder of `datafactory trace`, instead of --scene: the same paths again.")
    ] = None,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: Annotated[
        int, typer.Option(min=0, help="Scene frames in total, dealt to the scenes in turn.")
    ] = options.DEFAULT_FRAMES,
    points: Annotated[int, typer.Option(min=0, help="Close-target frames to add.")] = 0,
    seed: options.Seed = 0,
    poses: options.Poses = None,
    split: options.Split = DEFAULT_PATTERN,
    materials: options.Materials = None,
    store: options.Store = "range-channel",
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = 2,
    effects: options.Effects = "auto",
    noise: options.Noise = True,
    truth_window: options.TruthWindow = "taylor-30",
    error_budget: Annotated[
        float | None,
        typer.Option(
            min=-120.0,
            max=-1.0,
            show_default=False,
            help="Choose rays, depth, pruning, tolerance and truth terms for this error [dB], e.g. -30, from a sweep "
            "made once; --rays and --depth stay as given. Without it nothing is swept and the defaults hold.",
        ),
    ] = None,
    workers: options.Workers = 0,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
) -> None:
    """Render frames of scenes, and close-target frames beside them, into a dataset."""
    from datafactory.effects.catalogue import parse_effects
    from datafactory.frame.chain import ChainSettings
    from datafactory.frame.deal import parse_split_pattern
    from datafactory.frame.measurement import Processing
    from datafactory.paths.solver import TraceSettings
    from datafactory.run.order import Order
    from datafactory.run.stored import traced_split
    from datafactory.scenes.materials.table import load_materials
    from datafactory.scenes.poses import read_poses
    from shared.dataset import STORES
    from shared.radar import load_radar
    from shared.signal.windows import ANGLE_WINDOWS

    if bool(scene) == bool(paths):
        raise InputError("--scene", "given together with --paths" if paths else "missing", "either --scene or --paths")
    parse_split_pattern(split)
    if paths and not options.stated(context, "split"):
        split = traced_split(paths) or split
    given = read_poses(poses) if poses else ()
    if not (given or paths or frames + points):
        raise InputError("--frames", "0 and --points 0: nothing to render", "at least one frame")
    order = Order(
        radar=load_radar(radar),
        scenes=tuple(scene or ()) if given or frames else (),
        paths=paths,
        frames=0 if given else frames,
        points=points,
        seed=seed,
        split=split,
        poses=given,
        settings=ChainSettings(
            trace=TraceSettings(rays=rays, depth=depth),
            processing=Processing(
                noise=noise,
                store=options.choice("--store", store, STORES),
                truth_window=options.choice("--truth-window", truth_window, ANGLE_WINDOWS),
            ),
        ),
        effects=parse_effects(effects),
        budget_db=DEFAULT_BUDGET_DB if error_budget is None else error_budget,
    )
    table = load_materials(materials)
    running = options.Running(out, workers, resume, keep_going)
    if error_budget is None:
        options.run(order, table, running)
        return
    from datafactory.accuracy.budget import menu_for

    menu = menu_for(
        rays if options.stated(context, "rays") else None, depth if options.stated(context, "depth") else None
    )
    make_within_budget(order, table, error_budget, menu, running)
