"""``datafactory points``: close-target synthetic sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.frame.defaults import DEFAULT_FRAMES, DEFAULT_PATTERN


def points(
    out: options.Out,
    frames: Annotated[int, typer.Option(min=1, help="Frames of randomly drawn close targets.")] = DEFAULT_FRAMES,
    seed: options.Seed = 0,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    targets: Annotated[
        Path | None, typer.Option(help="JSON file of exactly these targets: one frame for each inner list.")
    ] = None,
    split: options.Split = DEFAULT_PATTERN,
    store: options.Store = "range-channel",
    noise: options.Noise = True,
    truth_window: options.TruthWindow = "taylor-30",
    licence: options.Licence = None,
    workers: options.Workers = 0,
    engine: options.EngineName = "local",
    address: options.Address = None,
    device: options.Device = options.DEFAULT_DEVICE,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
    shard: options.Shard = None,
    verbose: options.Verbose = False,
) -> None:
    """Render close-target frames, the paper's synthetic set, or exactly the targets of a file."""
    from datafactory.api import making
    from datafactory.frame.points import read_targets

    given = read_targets(targets) if targets else ()
    options.run(
        lambda announce, progress: making.render(
            None,
            out,
            radar=radar,
            frames=0,
            points=frames,
            targets=given,
            seed=seed,
            split=split,
            store=store,
            noise=noise,
            truth_window=truth_window,
            license=licence,
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
    options.next_step(out, shard, f"look:  datafactory inspect {out}")
