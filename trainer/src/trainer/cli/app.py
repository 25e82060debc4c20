"""``trainer``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import TyperCommand
from typer.exceptions import TyperException

from shared.processes.interrupt import INTERRUPTED, Ending, ending_with, run_app
from trainer.cli.captures import calibrate, import_
from trainer.cli.evaluate import evaluate
from trainer.cli.fit import fit
from trainer.cli.predict import export, predict
from trainer.errors import TrainingStopped, out_of_memory

EXAMPLES = {
    "fit": (
        "trainer fit build/mine --out build/run",
        "trainer fit build/mine --array sparse4 --steps 1500 --out build/run-sparse4",
    ),
    "predict": (
        "trainer predict build/mine --pretrained sparse6 --points --out build/images",
        "trainer predict build/run build/mine --out build/images-of-run",
    ),
    "evaluate": (
        "trainer evaluate build/mine --run build/run --out build/report",
        "trainer evaluate build/mine --methods das,music,iaa --arrays sparse6,sparse4 --out build/classical",
    ),
    "export": (
        "trainer export build/run --out build/run.onnx",
        "trainer export build/run-sparse4 --out build/run-sparse4.onnx",
    ),
    "calibrate": (
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 --out calibration.toml",
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 "
        "--check other.bin --check-range 4.1 --check-angle 15 --out checked.toml",
    ),
    "import": (
        "trainer import adc_data.bin --board iwr1843 --out cube.npz",
        "trainer import adc_data.bin --board iwr1843 --calibration calibration.toml --out calibrated.npz",
    ),
}
"""Two of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them.

``build/mine`` is a dataset that ``datafactory render`` made; captures are the reader's own.
"""
STOPPED = "interrupted; the same command with --resume goes on from the last checkpoint"
BEGINS_AGAIN = "interrupted; it has no --resume: run it again"


class Interrupted(Exception):
    """Ctrl-C in a command without ``--resume``; its text says what to do."""


class PlainCommand(TyperCommand):
    """A command whose help is plain text: Rich would take a unit in square brackets for markup, and drop it.

    :raises Interrupted: in :meth:`invoke`, which else raises what the command does
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        for parameter in self.params:
            if isinstance(text := getattr(parameter, "help", None), str):
                parameter.help = escape(text)  # type: ignore[attr-defined]

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            if any("--resume" in parameter.opts for parameter in self.params):
                raise
            # Pictures of the frames imaged so far may stand in predict's folder, which has to be empty.
            into = ", into a new or emptied --out" if self.name == "predict" else ""
            raise Interrupted(BEGINS_AGAIN + into) from None


app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)
for command in (fit, predict, evaluate, export, calibrate, import_):
    name = command.__name__.rstrip("_")
    app.command(name, cls=PlainCommand, epilog=ending_with(EXAMPLES[name]))(command)


def _version(wanted: bool) -> None:
    if wanted:
        from trainer import __version__

        typer.echo(f"trainer {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Radar datasets to networks that image sharper than the array."""


def main() -> None:
    """Entry point."""
    run_app("trainer", lambda: app(standalone_mode=False), STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    if isinstance(error, TrainingStopped):
        return str(error), 1
    if isinstance(error, Interrupted):
        return str(error), INTERRUPTED
    if isinstance(error, (MemoryError, RuntimeError)) and out_of_memory(error):
        reason = (str(error).strip().splitlines() or ["out of memory"])[0]
        return f"{reason}; expected a smaller --batch, --rows, --points or --width, or fewer --workers", 1
    if isinstance(error, TyperException):  # an empty message: without arguments the help has been printed already
        return " ".join(error.format_message().split()), 2
    return (STOPPED, INTERRUPTED) if isinstance(error, typer.Abort) else None
