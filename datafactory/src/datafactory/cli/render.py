"""``datafactory render``: scenes to a dataset."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from datafactory.cli import options
from datafactory.frame.defaults import DEFAULT_FRAMES, DEFAULT_PATTERN, LARGEST_BUDGET_DB, SMALLEST_BUDGET_DB
from datafactory.paths.defaults import DEFAULT_DEPTH, DEFAULT_RAYS


def render(
    context: typer.Context,
    out: options.Out,
    scenes: options.SceneNames = None,
    scene: options.Scenes = None,
    paths: options.Paths = None,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: Annotated[
        int, typer.Option(min=0, help="Scene frames in total, dealt to the scenes in turn.")
    ] = DEFAULT_FRAMES,
    points: Annotated[int, typer.Option(min=0, help="Close-target frames to add.")] = 0,
    seed: options.Seed = 0,
    variant: options.Variants = None,
    allow_missing: options.AllowMissing = False,
    populate: options.Populate = None,
    poses: options.Poses = None,
    trajectory: options.Trajectory = None,
    frame_rate: options.FrameRate = None,
    split: options.Split = DEFAULT_PATTERN,
    materials: options.Materials = None,
    store: options.Store = "range-channel",
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = DEFAULT_DEPTH,
    effects: options.Effects = "auto",
    noise: options.Noise = True,
    truth_window: options.TruthWindow = "taylor-30",
    licence: options.Licence = None,
    error_budget: Annotated[
        float | None,
        typer.Option(
            min=SMALLEST_BUDGET_DB,
            max=LARGEST_BUDGET_DB,
            show_default=False,
            help="Choose rays, depth, pruning, tolerance and truth terms for this error [dB], e.g. -30, from a sweep "
            "made once; --rays and --depth stay as given. Without it nothing is swept and the defaults hold.",
        ),
    ] = None,
    workers: options.Workers = 0,
    engine: options.EngineName = "local",
    address: options.Address = None,
    device: options.Device = options.DEFAULT_DEVICE,
    camera: Annotated[
        bool, typer.Option("--camera", help="Also what a camera at the sensor sees, DIR/camera/frame-NNNNNN.png.")
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Only say what it will take: frames, disk, memory, time; nothing is written."),
    ] = False,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
    shard: options.Shard = None,
    verbose: options.Verbose = False,
) -> None:
    """Render frames of scenes, and close-target frames beside them, into a dataset."""
    from datafactory.api import making
    from datafactory.api.asking import order_of
    from datafactory.api.forecasting import forecast
    from shared.dataset.locations import locate

    read = options.read_as_asked([*(scenes or ()), *(scene or ())], variant, allow_missing, populate, seed)
    asked: dict[str, Any] = {
        "paths": paths,
        "radar": radar,
        "frames": frames,
        "points": points,
        "seed": seed,
        "poses": poses,
        "trajectory": trajectory or None,
        "frame_rate": frame_rate,
        "split": split if options.stated(context, "split") else None,
        "store": store,
        "rays": rays if options.stated(context, "rays") else None,
        "depth": depth if options.stated(context, "depth") else None,
        "effects": effects,
        "noise": noise,
        "truth_window": truth_window,
        "license": licence,
        "error_budget": error_budget,
        "device": device,
    }
    if dry_run:
        for line in forecast(order_of(read, **asked), locate(out), workers, shard).lines():
            typer.echo(line)
        return
    options.run(
        lambda announce, progress: making.render(
            read,
            out,
            **asked,
            materials=materials,
            workers=workers,
            engine=engine,
            address=address,
            resume=resume,
            keep_going=keep_going,
            shard=shard,
            camera=camera,
            announce=announce,
            progress=progress,
        ),
        verbose,
    )
    options.next_step(out, shard, f"look:  datafactory inspect {out}")
