"""``datafactory``: the command line. Thin: parse, call the library, print.

The modules of this room import nothing that computes until a command runs: each command imports what it calls at its
own top. Everything else would make ``--help`` wait for the ray tracer.
"""

from __future__ import annotations

from typing import Any

import typer
from rich.markup import escape
from typer.core import TyperCommand
from typer.exceptions import TyperException

from datafactory.cli.accuracy import accuracy
from datafactory.cli.check import check
from datafactory.cli.city import city
from datafactory.cli.doctor import doctor
from datafactory.cli.inspect import inspect
from datafactory.cli.plan import plan
from datafactory.cli.points import points
from datafactory.cli.render import render
from datafactory.cli.scenes import scenes
from datafactory.cli.trace import trace
from shared.processes.command_line import Ending, run_app
from shared.processes.interrupt import INTERRUPTED

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
    help="Scenes to multipath to 77 GHz FMCW radar data in Parquet shards.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (render, points, plan, accuracy, trace, scenes, check, city, inspect, doctor):
    app.command(cls=PlainCommand)(command)


def main() -> None:
    """Entry point."""
    run_app("datafactory", lambda: app(standalone_mode=False), STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    from datafactory.run.workers import RunFailed

    if isinstance(error, RunFailed):
        return str(error), 1
    if isinstance(error, MemoryError):
        return f"out of memory ({error}); expected fewer samples, chirps, channels, rays or workers", 1
    if isinstance(error, TyperException):  # an empty message: without arguments the help has been printed already
        return " ".join(error.format_message().split()), 2
    return (STOPPED, INTERRUPTED) if isinstance(error, typer.Abort) else None
