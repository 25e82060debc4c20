"""``trainer``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

import typer
from typer.exceptions import TyperException

from shared.processes.command_line import Ending, run_app
from shared.processes.interrupt import INTERRUPTED
from trainer.cli.captures import calibrate, import_
from trainer.cli.evaluate import evaluate
from trainer.cli.export import export
from trainer.cli.fit import fit
from trainer.cli.predict import predict
from trainer.errors import TrainingStopped, out_of_memory

STOPPED = "interrupted; the same command with --resume goes on from the last checkpoint"

app = typer.Typer(
    help="Radar datasets to networks that image sharper than the array.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (fit, predict, evaluate, export, calibrate):
    app.command()(command)
app.command("import")(import_)


def main() -> None:
    """Entry point."""
    run_app("trainer", lambda: app(standalone_mode=False), STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    if isinstance(error, TrainingStopped):
        return str(error), 1
    if isinstance(error, (MemoryError, RuntimeError)) and out_of_memory(error):
        reason = (str(error).strip().splitlines() or ["out of memory"])[0]
        return f"{reason}; expected a smaller --batch, --rows, --points or --width, or fewer --workers", 1
    if isinstance(error, TyperException):  # an empty message: without arguments the help has been printed already
        return " ".join(error.format_message().split()), 2
    return (STOPPED, INTERRUPTED) if isinstance(error, typer.Abort) else None
