"""``datafactory``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

import sys
from typing import Any

import typer
from rich.markup import escape
from typer.core import TyperCommand
from typer.exceptions import TyperException

from datafactory.cli.accuracy import accuracy
from datafactory.cli.city import city
from datafactory.cli.doctor import doctor
from datafactory.cli.inspect import inspect
from datafactory.cli.plan import plan
from datafactory.cli.points import points
from datafactory.cli.render import render
from datafactory.cli.trace import trace
from datafactory.run.workers import RunFailed
from shared.physics.errors import InputError, require_utf8
from shared.processes.interrupt import INTERRUPTED


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
for command in (render, points, plan, accuracy, trace, city, inspect, doctor):
    app.command(cls=PlainCommand)(command)


def main() -> None:
    """Entry point: 0 done, 1 a run that failed, 2 bad arguments or bad input, each with one line."""
    try:
        for argument in sys.argv[1:]:
            require_utf8(argument)
        status = app(standalone_mode=False)
        if status == INTERRUPTED:  # how typer hands on Ctrl-C
            raise KeyboardInterrupt
        sys.exit(status)
    except InputError as error:
        _fail(str(error), 2)
    except OSError as error:
        _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", 1)
    except RunFailed as error:
        _fail(str(error), 1)
    except MemoryError as error:
        _fail(f"out of memory ({error}); expected fewer samples, chirps, channels, rays or workers", 1)
    except TyperException as error:
        _fail(" ".join(error.format_message().split()), 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; what was finished is kept: the same command with --resume goes on", INTERRUPTED)


def _fail(line: str, status: int) -> None:
    if line:  # without arguments the help has been printed already
        print(f"datafactory: {line}", file=sys.stderr)
    sys.exit(status)
