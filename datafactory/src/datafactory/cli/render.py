"""``datafactory render``: scenes to a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.frames import Processing
from datafactory.paths.trace import TraceSettings
from datafactory.pipeline import Order
from datafactory.scenes.materials import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.shards import parse_split_pattern
from shared.dataset import STORES
from shared.errors import InputError
from shared.radar import load_radar
from shared.windows import ANGLE_WINDOWS


def render(
    scene: Annotated[
        list[str],
        typer.Option(help="USD, Mitsuba XML or mesh file, or sionna:NAME; may be repeated.", show_default=False),
    ],
    out: options.Out,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: Annotated[int, typer.Option(min=0, help="Scene frames in total, dealt to the scenes in turn.")] = 8,
    points: Annotated[int, typer.Option(min=0, help="Close-target frames to add.")] = 0,
    seed: options.Seed = 0,
    poses: Annotated[
        Path | None, typer.Option(help="JSON file of sensor poses: one frame a pose, instead of drawn ones.")
    ] = None,
    split: options.Split = "6:1:1",
    materials: Annotated[Path | None, typer.Option(help="TOML file that overrides the material table.")] = None,
    store: options.Store = "range-channel",
    rays: Annotated[int, typer.Option(min=1, max=20_000_000, help="Rays a frame, over the field of view.")] = 200_000,
    depth: Annotated[int, typer.Option(min=1, max=3, help="Largest number of bounces.")] = 2,
    noise: options.Noise = True,
    truth_window: options.TruthWindow = "taylor-30",
    workers: options.Workers = 0,
    resume: options.Resume = False,
) -> None:
    """Render frames of scenes, and close-target frames beside them, into a dataset."""
    parse_split_pattern(split)
    given = read_poses(poses) if poses else ()
    if not given and frames + points == 0:
        raise InputError("--frames", "0 and --points 0: nothing to render", "at least one frame")
    order = Order(
        radar=load_radar(radar),
        scenes=tuple(scene) if given or frames else (),
        frames=0 if given else frames,
        points=points,
        seed=seed,
        split=split,
        poses=given,
        processing=Processing(
            noise=noise,
            store=options.choice("--store", store, STORES),
            truth_window=options.choice("--truth-window", truth_window, ANGLE_WINDOWS),
        ),
        trace=TraceSettings(rays=rays, depth=depth),
    )
    options.run(order, load_materials(materials), out, workers, resume)
