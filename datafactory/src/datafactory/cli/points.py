"""``datafactory points``: close-target synthetic sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.frame.defaults import DEFAULT_PATTERN


def points(
    out: options.Out,
    frames: Annotated[int, typer.Option(min=1, help="Frames of randomly drawn close targets.")] = 8,
    seed: options.Seed = 0,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    targets: Annotated[
        Path | None, typer.Option(help="JSON file of exactly these targets: one frame for each inner list.")
    ] = None,
    split: options.Split = DEFAULT_PATTERN,
    store: options.Store = "range-channel",
    noise: options.Noise = True,
    truth_window: options.TruthWindow = "taylor-30",
    workers: options.Workers = 0,
    resume: options.Resume = False,
    keep_going: options.KeepGoing = False,
) -> None:
    """Render close-target frames, the paper's synthetic set, or exactly the targets of a file."""
    from datafactory.frame.chain import ChainSettings
    from datafactory.frame.deal import parse_split_pattern
    from datafactory.frame.measurement import Processing
    from datafactory.frame.points import read_targets
    from datafactory.run.order import Order
    from datafactory.scenes.materials.table import load_materials
    from shared.dataset import STORES
    from shared.radar import load_radar
    from shared.signal.windows import ANGLE_WINDOWS

    parse_split_pattern(split)
    order = Order(
        radar=load_radar(radar),
        points=0 if targets else frames,
        targets=read_targets(targets) if targets else (),
        seed=seed,
        split=split,
        settings=ChainSettings(
            processing=Processing(
                noise=noise,
                store=options.choice("--store", store, STORES),
                truth_window=options.choice("--truth-window", truth_window, ANGLE_WINDOWS),
            )
        ),
    )
    options.run(order, load_materials(None), options.Running(out, workers, resume, keep_going))
