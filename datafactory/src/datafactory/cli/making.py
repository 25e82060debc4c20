"""What writes datasets, and a city: ``render``, ``points``, ``trace``, ``merge``, ``convert`` and ``city``."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from datafactory.api.options import (
    CityOptions,
    ConvertOptions,
    MergeOptions,
    PointsOptions,
    RenderOptions,
    RunOptions,
    TraceOptions,
)
from datafactory.defaults import DEFAULT_FRAMES
from shared.cli.console import plain_console
from shared.cli.options import asking
from shared.physics.errors import InputError

if TYPE_CHECKING:
    from datafactory.run.pipeline import Report

Verbose: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Also say what was counted: rays, paths, what was left out and why.")
]


@asking(RenderOptions)
def render(
    asked: RenderOptions,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Only say what it will take: frames, disk, memory, time; nothing is written."),
    ] = False,
    verbose: Verbose = False,
) -> None:
    """Render frames of scenes, and close-target frames beside them, into a dataset."""
    from datafactory.api import making
    from datafactory.api.asking import materials_of, order_of
    from datafactory.api.forecasting import forecast
    from datafactory.run.preparation import prepare
    from shared.dataset.locations import locate

    if dry_run:
        recipe = prepare(order_of(asked), materials_of(asked.materials))
        for line in forecast(recipe, locate(asked.out), asked.workers, asked.shard).lines():
            typer.echo(line)
        return
    _run(partial(making.render, **vars(asked)), verbose)
    next_step(asked, f"look:  datafactory inspect {typed(asked.out)}")


@asking(PointsOptions)
def points(asked: PointsOptions, verbose: Verbose = False) -> None:
    """Render close-target frames, the paper's synthetic set, or exactly the targets of a file."""
    from datafactory.api import making

    if asked.targets and asked.frames is not None:
        raise InputError("--frames", "beside --targets, which has a list a frame", "one of them")
    drawn = 0 if asked.targets else DEFAULT_FRAMES if asked.frames is None else asked.frames
    given = {**vars(asked), "scenes": None, "frames": 0, "points": drawn}
    _run(partial(making.render, **given), verbose)
    next_step(asked, f"look:  datafactory inspect {typed(asked.out)}")


@asking(TraceOptions)
def trace(asked: TraceOptions, verbose: Verbose = False) -> None:
    """Trace multipath into DIR/paths; `datafactory render --paths DIR` renders any radar from it.

    Of the radar, only its wavelength matters here, and with --error-budget its antennas and resolution.
    """
    from datafactory.api import making

    _run(partial(making.trace, **vars(asked)), verbose)
    next_step(asked, f"next:  datafactory render --paths {typed(asked.out)} --out ANOTHER_FOLDER")


@asking(MergeOptions)
def merge(asked: MergeOptions, verbose: Verbose = False) -> None:
    """Join the jobs of an array into one dataset: the shards and the manifest of the run in one piece.

    Shards are linked where the jobs lie on the same disk, and copied where not.
    """
    from datafactory.api import making

    _run(partial(making.merge, **vars(asked)), verbose)
    typer.echo(f"look:  datafactory inspect {typed(asked.out)}")


@asking(ConvertOptions)
def convert(asked: ConvertOptions) -> None:
    """Write a dataset in another layout, and say what has no place in it."""
    from datafactory.api.making import convert as made
    from shared.cli.progress import bars

    console = plain_console()
    with bars(console, transient=True) as advance:
        converted = made(**{**vars(asked), "progress": advance})
    console.print(f"{converted.frames} frames in {converted.directory}")
    for note in converted.notes:
        console.print(f"  {note}")


@asking(CityOptions)
def city(asked: CityOptions) -> None:
    """Write a city: a procedural one for --populate, or one with traffic on the roads of a real network."""
    blocks, centre, extent = asked.blocks, asked.centre, asked.extent
    if asked.opendrive is not None and asked.osm is not None:
        raise InputError("city", "--opendrive and --osm are both given", "one of the two")
    source = asked.osm if asked.opendrive is None else asked.opendrive
    if source is None:
        if centre is not None or extent is not None:
            raise InputError(
                "city", "--centre and --extent without a network", "--opendrive FILE or --osm FILE beside them"
            )
        from datafactory.scenes.city.city import write_city

        write_city(asked.out, asked.seed, 2 if blocks is None else blocks, asked.style)
        typer.echo(
            f"wrote {asked.out}: nothing moves in it; --populate of the other commands puts traffic in its streets"
        )
        return
    if blocks is not None:
        raise InputError("city", "--blocks beside a network", "--extent, which says how much of it")
    from datafactory.scenes.network.town import write_town

    form, window = "osm" if asked.opendrive is None else "opendrive", {} if extent is None else {"extent": extent}
    middle = None if centre is None else _place(centre)
    moving = write_town(asked.out, source, form, asked.seed, asked.style, middle, **window)
    typer.echo(f"wrote {asked.out}: {moving} vehicles in its traffic")


def _run(make: Callable[..., Report], verbose: bool) -> Report:
    """Make a dataset with its progress in view, and print what was made.

    :param make: takes ``announce`` and ``progress``
    :param verbose: also what was counted
    """
    from datafactory.inspection.dataset import told
    from shared.cli.progress import bars

    console = plain_console()
    with bars(console) as advance:
        report = make(announce=console.print, progress=advance)
    kept = f" ({report.shards_kept} shards kept from before)" if report.shards_kept else ""
    took = f"{report.seconds:.0f} s, opening of the scenes included"
    console.print(f"{report.frames} frames in {report.directory}, {took}{kept}")
    for line in told(report.counts, verbose):
        console.print(f"  {line}")
    return report


def next_step(asked: RunOptions, step: str) -> None:
    """Print the command that comes next: of a job it is the merge, which takes local folders.

    :param step: what comes next of a run in one piece
    """
    if asked.shard is not None:
        step = f"next:  datafactory merge {typed(asked.out)} --out ANOTHER_FOLDER, once all jobs are done"
    if asked.shard is not None and "://" in str(asked.out):
        copy = f"copy {asked.out} to a local FOLDER; datafactory merge FOLDER --out DIR"
        step = f"next:  once all jobs are done, {copy}"
    typer.echo(step)


def typed(path: object) -> str:
    """A path as a shell takes it."""
    return shlex.quote(str(path))


def _place(text: str) -> tuple[float, float]:
    """``"x,y"`` in metres."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError("city --centre", repr(text), "two numbers with a comma between them, x,y in metres")
    return x, y
