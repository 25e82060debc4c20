"""Options that several commands share, and how a run is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer
from rich.console import Console

from datafactory.cli.progress import Advance, shown
from datafactory.paths.defaults import CPU, LARGEST_DEPTH, MOST_RAYS
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
Populate = Annotated[
    str | None,
    typer.Option(
        "--populate",
        metavar="KIND=N,...",
        help="Traffic and street furniture on the free ground, e.g. cars=20,pedestrians=10,poles=30,parked=0.6.",
        show_default=False,
    ),
]
Poses = Annotated[
    Path | None, typer.Option("--poses", help="JSON file of sensor poses: one frame a pose, instead of drawn ones.")
]
Trajectory = Annotated[
    list[str] | None,
    typer.Option(
        "--trajectory",
        metavar="FILE|drive",
        help="CSV or JSON file of poses with times, a sequence of frames; may be repeated. "
        "Or drive[:speed=M/S][,seconds=S]: drives drawn along the streets, --frames in all.",
        show_default=False,
    ),
]
FrameRate = Annotated[
    float | None,
    typer.Option("--frame-rate", help="Frames a second along a trajectory; by default a frame a row, 10 of drives."),
]
Materials = Annotated[Path | None, typer.Option("--materials", help="TOML file that overrides the material table.")]
Rays = Annotated[int, typer.Option("--rays", min=1, max=MOST_RAYS, help="Rays a frame, over the field of view.")]
Depth = Annotated[
    int,
    typer.Option(
        "--depth",
        min=1,
        max=LARGEST_DEPTH,
        help=f"Largest number of bounces. From 2 on, mirrors alone may be {LARGEST_DEPTH}.",
    ),
]
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
Licence = Annotated[
    str | None,
    typer.Option(
        "--license",
        help="Of the data, an SPDX identifier as CC-BY-4.0, for README.md and the manifest; by default not stated.",
        show_default=False,
    ),
]
Workers = Annotated[
    int,
    typer.Option(
        "--workers",
        min=0,
        help="Worker processes; 0: one a core if memory is there, one with cuda, of all nodes with --engine ray.",
    ),
]
EngineName = Annotated[
    str, typer.Option("--engine", help="local, or ray: a Ray cluster makes the shards. The same bytes.")
]
Address = Annotated[
    str | None,
    typer.Option(
        "--address",
        help="HOST:PORT of the Ray cluster, which this machine is a node of; by default the one that runs here, "
        "else one of the run's own.",
        show_default=False,
    ),
]
Shard = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="I/N",
        show_default=False,
        help="Make the shards of job I of N alone, I from 0 to N - 1, into DIR/job-I-of-N; `datafactory merge` joins "
        "the jobs.",
    ),
]
Device = Annotated[
    str,
    typer.Option(
        "--device", help="cpu, cuda (an NVIDIA GPU), or auto: cuda where it can be used. The bytes depend on it."
    ),
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Also say what was counted: rays, paths, what was left out and why.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run in the same folder.")]

DEFAULT_RADAR_NAME = DEFAULT_RADAR
DEFAULT_DEVICE = CPU


def read_as_asked(
    scenes: list[str], variant: list[str] | None, allow_missing: bool, populate: str | None = None, seed: int = 0
) -> Sequence[str | Scene]:
    """The scenes' names, or the scenes themselves where the user says how they are to be read, or to be populated."""
    if populate is not None and not scenes:
        raise InputError("--populate", "given without a scene", "--scene with it")
    if not (variant or allow_missing or populate is not None):
        return scenes
    from datafactory.api.asking import load_scene

    return [
        load_scene(name, variant=variant or (), allow_missing=allow_missing, populate=populate, seed=seed)
        for name in scenes
    ]


def stated(context: typer.Context, name: str) -> bool:
    """Whether the user gave this option."""
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


Make: TypeAlias = "Callable[[Callable[[str], None], Advance], Report]"
"""A function of :mod:`datafactory.api.making`, but for what takes its lines and its progress."""


def run(make: Make, verbose: bool) -> Report:
    """Make a dataset with its progress in view, and print what was made.

    :param verbose: also what was counted
    """
    from datafactory.run.counts import told

    console = Console(soft_wrap=True, highlight=False)
    with shown(console) as advance:
        report = make(lambda line: console.print(line, markup=False), advance)
    kept = f" ({report.shards_kept} shards kept from before)" if report.shards_kept else ""
    took = f"{report.seconds:.0f} s, opening and planning included"
    console.print(f"{report.frames} frames in {report.directory}, {took}{kept}", markup=False)
    for line in told(report.counts, verbose):
        console.print(f"  {line}", markup=False)
    return report


def next_step(out: str, shard: str | None, step: str) -> None:
    """Print the command that comes next: of a job it is the merge, which takes local folders.

    :param step: what comes next of a run in one piece
    """
    if shard is not None:
        step = f"next:  datafactory merge {out} --out ANOTHER_FOLDER, once all jobs are done"
        if "://" in out:
            step = f"next:  once all jobs are done, copy {out} to a local FOLDER; datafactory merge FOLDER --out DIR"
    typer.echo(step)


def one_scene(name: str | None, scene: str | None) -> str | None:
    """The scene of a command that takes one, by its place or by ``--scene``.

    :raises InputError: both are given
    """
    if name is not None and scene is not None:
        raise InputError("--scene", f"{scene!r} beside {name!r}", "one scene")
    return scene if name is None else name
