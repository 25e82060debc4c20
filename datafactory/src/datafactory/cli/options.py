"""Options that several commands share, and how a run is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer
from rich.console import Console

from datafactory.cli.progress import Advance, shown
from datafactory.paths.defaults import LARGEST_DEPTH, MOST_RAYS
from shared.physics.errors import InputError
from shared.processes.defaults import DEFAULT_RADAR, LARGEST_SEED

if TYPE_CHECKING:
    from datafactory.run.pipeline import Report
    from datafactory.scenes.scene import Scene

Out = Annotated[
    str,
    typer.Option(
        "--out", metavar="DIR", help="Folder of the dataset, also s3:// or gs://; new or empty.", show_default=False
    ),
]
Paths = Annotated[
    str | None,
    typer.Option(
        "--paths",
        metavar="DIR",
        help="Folder of `datafactory trace`, also by URI, instead of --scene: the same paths again.",
        show_default=False,
    ),
]
RadarName = Annotated[str, typer.Option("--radar", help="A preset or a TOML file.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Dataset seed: same seed, same bytes.")]
Split = Annotated[str, typer.Option("--split", help="Pattern train:validation:test over the frames.")]
Frames = Annotated[int, typer.Option("--frames", min=1, help="Scene frames in total, dealt to the scenes in turn.")]
Store = Annotated[str, typer.Option("--store", help="range-channel, range-doppler or cube: what else to keep.")]
Scenes = Annotated[
    list[str] | None,
    typer.Option(
        "--scene",
        help="USD, Mitsuba XML or mesh file, or shipped:NAME or sionna:NAME; may be repeated.",
        show_default=False,
    ),
]
SceneName = Annotated[
    str | None, typer.Argument(metavar="[SCENE]", help="The scene, in place of --scene.", show_default=False)
]
SceneNames = Annotated[
    list[str] | None,
    typer.Argument(metavar="[SCENE]...", help="Scenes, in place of --scene or beside it.", show_default=False),
]
Variants = Annotated[
    list[str] | None,
    typer.Option("--variant", help="set=name: a variant of the USD scenes; may be repeated.", show_default=False),
]
AllowMissing = Annotated[bool, typer.Option("--allow-missing", help="Go on without geometry that cannot be opened.")]
Poses = Annotated[
    Path | None, typer.Option("--poses", help="JSON file of sensor poses: one frame a pose, instead of drawn ones.")
]
Materials = Annotated[Path | None, typer.Option("--materials", help="TOML file that overrides the material table.")]
Rays = Annotated[int, typer.Option("--rays", min=1, max=MOST_RAYS, help="Rays a frame, over the field of view.")]
Depth = Annotated[int, typer.Option("--depth", min=1, max=LARGEST_DEPTH, help="Largest number of bounces.")]
Effects = Annotated[
    str, typer.Option("--effects", help="auto (what each scene calls for), all, or names separated by commas.")
]
KeepGoing = Annotated[
    bool, typer.Option("--keep-going", help="Finish the other shards where three worker processes died of one.")
]
Noise = Annotated[bool, typer.Option("--noise/--no-noise", help="Add receiver noise.")]
TruthWindow = Annotated[
    str, typer.Option("--truth-window", help="Over the virtual sensor: none, taylor-25, taylor-30 or hann.")
]
Workers = Annotated[int, typer.Option("--workers", min=0, help="Worker processes; 0: one a core.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Also say what was counted: rays, paths, what was left out and why.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run in the same folder.")]

DEFAULT_RADAR_NAME = DEFAULT_RADAR


def read_as_asked(scenes: list[str], variant: list[str] | None, allow_missing: bool) -> Sequence[str | Scene]:
    """The scenes' names, or the scenes themselves where the user says how they are to be read."""
    if not (variant or allow_missing):
        return scenes
    from datafactory.api.asking import load_scene

    return [load_scene(name, variant=variant or (), allow_missing=allow_missing) for name in scenes]


def stated(context: typer.Context, name: str) -> bool:
    """Whether the user gave this option."""
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


Make: TypeAlias = "Callable[[Callable[[str], None], Advance], Report]"
"""A function of :mod:`datafactory.api.making`, but for what takes its lines and its progress."""


def run(make: Make, out: str, verbose: bool) -> Report:
    """Make a dataset with its progress in view, and print what was made.

    :param verbose: also what was counted
    """
    from datafactory.run.counts import told

    console = Console(soft_wrap=True, highlight=False)
    with shown(console) as advance:
        report = make(lambda line: console.print(line, markup=False), advance)
    kept = f" ({report.shards_kept} shards kept from before)" if report.shards_kept else ""
    took = f"{report.seconds:.0f} s, opening and planning included"
    console.print(f"{report.frames} frames in {out}, {took}{kept}", markup=False)
    for line in told(report.counts, verbose):
        console.print(f"  {line}", markup=False)
    return report


def one_scene(name: str | None, scene: str | None) -> str | None:
    """The scene of a command that takes one, by its place or by ``--scene``.

    :raises InputError: both are given
    """
    if name is not None and scene is not None:
        raise InputError("--scene", f"{scene!r} beside {name!r}", "one scene")
    return scene if name is None else name
