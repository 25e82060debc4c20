"""``datafactory``: the command line. Thin: parse, call the library, print.

The modules of this room import nothing that computes until a command runs: each command imports what it calls at its
own top. Everything else would make ``--help`` wait for the ray tracer.
"""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperCommand
from typer.exceptions import TyperException

from datafactory.cli.costs import accuracy, plan
from datafactory.cli.inspection import check, doctor, inspect, scenes, view
from datafactory.cli.making import city, convert, merge, points, render, trace
from shared.processes.interrupt import INTERRUPTED, Ending, ending_with, run_app

EXAMPLES = {
    "render": (
        "datafactory render shipped:street --frames 16 --out build/mine",
        "datafactory render sionna:munich --populate cars=4/100m,parked=0.6 --frames 64 --points 16 --out build/munich",
    ),
    "points": (
        "datafactory points --frames 64 --out build/points",
        "datafactory points --frames 64 --no-noise --seed 1 --out build/clean",
    ),
    "plan": ("datafactory plan shipped:street", "datafactory plan sionna:munich --frames 8 --no-times --json"),
    "accuracy": (
        "datafactory accuracy shipped:street --out build/accuracy",
        "datafactory accuracy sionna:munich --quick --out build/accuracy-munich",
    ),
    "trace": (
        "datafactory trace shipped:street --frames 16 --out build/paths",
        "datafactory trace sionna:munich --rays 500000 --frames 64 --out build/paths-munich",
    ),
    "merge": (
        "datafactory merge build/jobs --out build/whole",
        "datafactory merge build/jobs/job-0-of-2 build/jobs/job-1-of-2 --out build/both",
    ),
    "view": (
        "datafactory view shipped:street --out build/street.html",
        "datafactory view sionna:munich --frames 8 --frame 3 --rays 20000 --out build/munich.html",
    ),
    "scenes": ("datafactory scenes", "datafactory check shipped:tiny"),
    "check": ("datafactory check shipped:street", "datafactory check sionna:munich --json"),
    "city": (
        "datafactory city --out build/city.usda",
        "datafactory city --seed 7 --blocks 3 --out build/city-7.usda",
    ),
    "inspect": ("datafactory inspect build/mine", "datafactory inspect build/mine --verify --frames 0"),
    "convert": (
        "datafactory convert build/mine --to mcap --out build/mcap",
        "datafactory convert build/munich --to mcap --out build/mcap-munich",
    ),
    "doctor": ("datafactory doctor", "datafactory doctor --json"),
}
"""Two of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them."""
STOPPED = "interrupted; what was finished is kept: the same command with --resume goes on"


class PlainCommand(TyperCommand):
    """A command whose help is plain text: Rich would take a unit in square brackets for markup, and drop it."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.help = escape(self.help or "")
        for parameter in self.params:
            if isinstance(text := getattr(parameter, "help", None), str):
                parameter.help = escape(text)  # type: ignore[attr-defined]


app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)
for command in (render, points, plan, accuracy, trace, merge, view, scenes, check, city, inspect, convert, doctor):
    app.command(cls=PlainCommand, epilog=ending_with(EXAMPLES[command.__name__]))(command)


def _version(wanted: bool) -> None:
    if wanted:
        from datafactory import __version__

        typer.echo(f"datafactory {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Scenes to multipath to 77 GHz FMCW radar data in Parquet shards."""


def main() -> None:
    """Entry point."""
    run_app("datafactory", lambda: app(standalone_mode=False), STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    from datafactory.run.portions import RunFailed

    if isinstance(error, RunFailed):
        return str(error), 1
    if isinstance(error, MemoryError):
        return f"out of memory ({error}); expected fewer samples, chirps, channels, rays or workers", 1
    if isinstance(error, TyperException):  # an empty message: without arguments the help has been printed already
        return " ".join(error.format_message().split()), 2
    return (STOPPED, INTERRUPTED) if isinstance(error, typer.Abort) else None
