"""``datafactory trace``: multipath alone, to render radars from later."""

from __future__ import annotations

from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.frame.defaults import DEFAULT_FRAMES, DEFAULT_PATTERN, LARGEST_BUDGET_DB, SMALLEST_BUDGET_DB
from datafactory.paths.defaults import DEFAULT_DEPTH, DEFAULT_RAYS


def trace(
    context: typer.Context,
    out: options.Out,
    scenes: options.SceneNames = None,
    scene: options.Scenes = None,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: options.Frames = DEFAULT_FRAMES,
    seed: options.Seed = 0,
    variant: options.Variants = None,
    allow_missing: options.AllowMissing = False,
    populate: options.Populate = None,
    poses: options.Poses = None,
    trajectory: options.Trajectory = None,
    frame_rate: options.FrameRate = None,
    split: options.Split = DEFAULT_PATTERN,
    materials: options.Materials = None,
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = DEFAULT_DEPTH,
    effects: options.Effects = "auto",
    error_budget: Annotated[
        float | None,
        typer.Option(
            min=SMALLEST_BUDGET_DB,
            max=LARGEST_BUDGET_DB,
            show_default=False,
            help="Choose rays and depth for this error [dB] of the power in a resolution cell of this radar, e.g. -30, "
            "from a sweep made once; --rays and --depth stay as given.",
        ),
    ] = None,
    workers: options.Workers = 0,
    engine: options.EngineName = "local",
    address: options.Address = None,
    device: options.Device = options.DEFAULT_DEVICE,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
    shard: options.Shard = None,
    verbose: options.Verbose = False,
) -> None:
    """Trace multipath into DIR/paths; `datafactory render --paths DIR` renders any radar from it.

    Of the radar, only its wavelength matters here, and with --error-budget its antennas and resolution.
    """
    from datafactory.api import making

    options.run(
        lambda announce, progress: making.trace(
            options.read_as_asked([*(scenes or ()), *(scene or ())], variant, allow_missing, populate, seed),
            out,
            radar=radar,
            frames=frames,
            seed=seed,
            poses=poses,
            trajectory=trajectory or None,
            frame_rate=frame_rate,
            split=split,
            materials=materials,
            rays=rays if options.stated(context, "rays") else None,
            depth=depth if options.stated(context, "depth") else None,
            effects=effects,
            error_budget=error_budget,
            workers=workers,
            engine=engine,
            address=address,
            device=device,
            resume=resume,
            keep_going=keep_going,
            shard=shard,
            announce=announce,
            progress=progress,
        ),
        verbose,
    )
    options.next_step(out, shard, f"next:  datafactory render --paths {out} --out ANOTHER_FOLDER")
