"""``datafactory view``: the scene, the sensor and the strongest paths, in three dimensions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options
from datafactory.cli.progress import shown
from datafactory.cli.tables import plain_console
from datafactory.frame.defaults import DEFAULT_FRAMES
from datafactory.paths.defaults import DEFAULT_DEPTH, DEFAULT_RAYS


def view(
    out: Annotated[Path, typer.Option("--out", help="The page to write, .html; a browser opens it from disk.")],
    scene_name: options.SceneName = None,
    scene: Annotated[
        str | None,
        typer.Option(help="USD, Mitsuba XML or mesh file, or shipped:NAME or sionna:NAME.", show_default=False),
    ] = None,
    paths: options.Paths = None,
    frame: Annotated[int, typer.Option(min=0, help="Which frame: of --poses, of --paths, or of the drawn ones.")] = 0,
    variant: options.Variants = None,
    allow_missing: options.AllowMissing = False,
    populate: options.Populate = None,
    poses: options.Poses = None,
    radar: options.RadarName = options.DEFAULT_RADAR_NAME,
    frames: options.Frames = DEFAULT_FRAMES,
    seed: options.Seed = 0,
    materials: options.Materials = None,
    rays: options.Rays = DEFAULT_RAYS,
    depth: options.Depth = DEFAULT_DEPTH,
    effects: options.Effects = "all",
    png: Annotated[
        bool, typer.Option("--png", help="Also two pictures beside it: from the sensor, and from above.")
    ] = False,
) -> None:
    """Show a scene in three dimensions: materials, sensor, field of view, what moves, and the strongest paths.

    The frame is the one that `datafactory render` makes of the same arguments.
    """
    from datafactory.api import viewing

    console = plain_console()
    with shown(console, transient=True) as advance:
        named = options.one_scene(scene_name, scene)
        looked_at = None if named is None else options.read_as_asked([named], variant, allow_missing, populate, seed)[0]
        written = viewing.view(
            looked_at, out, paths=paths, frame=frame, poses=poses, radar=radar,
            frames=frames, seed=seed,
            materials=materials, rays=rays, depth=depth, effects=effects, png=png, announce=console.print,
            progress=advance,
        )  # fmt: skip
    for path in written:
        console.print(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB")
