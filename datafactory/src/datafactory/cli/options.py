"""Options that several commands share, and how a run is shown."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from shared.physics.errors import InputError
from shared.processes.defaults import DEFAULT_RADAR, LARGEST_SEED

if TYPE_CHECKING:
    from datafactory.run.order import Order
    from datafactory.run.pipeline import Execution, Report
    from datafactory.scenes.materials.table import MaterialTable

Out = Annotated[Path, typer.Option("--out", help="Folder of the dataset; new or empty.", show_default=False)]
RadarName = Annotated[str, typer.Option("--radar", help="A preset or a TOML file.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Dataset seed: same seed, same bytes.")]
Split = Annotated[str, typer.Option("--split", help="Pattern train:validation:test over the frames.")]
Frames = Annotated[int, typer.Option("--frames", min=1, help="Scene frames in total, dealt to the scenes in turn.")]
Store = Annotated[str, typer.Option("--store", help="range-channel, range-doppler or cube: what else to keep.")]
Scenes = Annotated[
    list[str] | None,
    typer.Option("--scene", help="USD, Mitsuba XML or mesh file, or sionna:NAME; may be repeated.", show_default=False),
]
Poses = Annotated[
    Path | None, typer.Option("--poses", help="JSON file of sensor poses: one frame a pose, instead of drawn ones.")
]
Materials = Annotated[Path | None, typer.Option("--materials", help="TOML file that overrides the material table.")]
Rays = Annotated[int, typer.Option("--rays", min=1, max=20_000_000, help="Rays a frame, over the field of view.")]
Depth = Annotated[int, typer.Option("--depth", min=1, max=3, help="Largest number of bounces.")]
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
Resume = Annotated[bool, typer.Option("--resume", help="Go on with an unfinished run in the same folder.")]

DEFAULT_RADAR_NAME = DEFAULT_RADAR
DEFAULT_FRAMES = 8


def order_of(
    scene: list[str] | None,
    poses: Path | None,
    frames: int,
    split: str,
    seed: int,
    radar: str,
    rays: int,
    depth: int,
    budget_db: float,
) -> Order:
    """The scene frames that a command was asked for, to be traced with these settings.

    :raises InputError: no scene, or whatever is wrong with split, poses or radar
    """
    from datafactory.frame.chain import ChainSettings
    from datafactory.frame.deal import parse_split_pattern
    from datafactory.paths.solver import TraceSettings
    from datafactory.run.order import Order
    from datafactory.scenes.poses import read_poses
    from shared.radar import load_radar

    parse_split_pattern(split)
    if not scene:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME")
    given = read_poses(poses) if poses else ()
    return Order(
        radar=load_radar(radar),
        scenes=tuple(scene),
        frames=0 if given else frames,
        seed=seed,
        split=split,
        poses=given,
        settings=ChainSettings(trace=TraceSettings(rays=rays, depth=depth)),
        budget_db=budget_db,
    )


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def choice(option: str, value: str, allowed: tuple[str, ...]) -> str:
    """``value``, if it is one of ``allowed``."""
    if value not in allowed:
        raise InputError(option, repr(value), f"one of {', '.join(allowed)}")
    return value


def stated(context: typer.Context, name: str) -> bool:
    """Whether the user gave this option."""
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


Make: TypeAlias = "Callable[[Order, MaterialTable, Execution], Report]"
"""What a command runs: :func:`datafactory.run.pipeline.render` or :func:`datafactory.run.pipeline.trace_paths`."""


@dataclass(frozen=True)
class Running:
    """How a command runs, as its options say.

    :param workers: 0 takes one for each core
    """

    out: Path
    workers: int = 0
    resume: bool = False
    keep_going: bool = False


def run(order: Order, table: MaterialTable, running: Running, make: Make | None = None) -> Report:
    """Make a dataset with a progress bar, and print what was made.

    :param make: None renders
    """
    from datafactory.frame.chain import FRAMES_WITH
    from datafactory.run.pipeline import Execution, render

    make = make or render
    console = Console(soft_wrap=True, highlight=False)
    with _bar(console) as advance:
        execution = Execution(
            running.out,
            running.workers or cores(),
            running.resume,
            running.keep_going,
            announce=lambda line: console.print(line, markup=False),
            looked=partial(advance, "planning"),
            advance=partial(advance, "frames"),
        )
        report = make(order, table, execution)
    kept = f" ({report.shards_kept} shards kept from before)" if report.shards_kept else ""
    console.print(f"{report.frames} frames in {running.out}, {report.seconds:.0f} s{kept}", markup=False)
    for name, count in report.counts.items():
        if name != "frames" and not name.startswith(FRAMES_WITH) and count:
            console.print(f"  {name.replace('_', ' ')}: {count:.0f}", markup=False)
    made_with = {name.removeprefix(FRAMES_WITH): n for name, n in report.counts.items() if name.startswith(FRAMES_WITH)}
    if made_with:
        console.print(f"  frames with {', '.join(f'{name} {n:.0f}' for name, n in made_with.items())}", markup=False)
    if make is render:
        console.print(f"look:  datafactory inspect {running.out}", markup=False)
    return report


@contextmanager
def _bar(console: Console) -> Iterator:
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, speed_estimate_period=600.0) as progress:
        task = progress.add_task("opening", total=None, rate="")

        def advance(stage: str, done: int, total: int) -> None:
            if progress.tasks[task].description != stage:
                progress.reset(task, description=stage, total=total, completed=done)
            progress.update(task, completed=done, total=total)
            speed = progress.tasks[task].speed
            progress.update(task, rate=f"{speed:.2f} frames/s" if speed else "")

        yield advance
