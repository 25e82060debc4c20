"""``trainer``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

import sys

import typer
from typer.exceptions import TyperException

from shared.physics.errors import InputError, require_utf8
from shared.processes.interrupt import INTERRUPTED
from trainer.cli.evaluate import evaluate
from trainer.cli.export import export
from trainer.cli.fit import fit
from trainer.cli.predict import predict
from trainer.errors import TrainingStopped, out_of_memory

app = typer.Typer(
    help="Radar datasets to networks that image sharper than the array.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (fit, predict, evaluate, export):
    app.command()(command)


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
    except TrainingStopped as error:
        _fail(str(error), 1)
    except (MemoryError, RuntimeError) as error:
        if not out_of_memory(error):
            raise
        reason = (str(error).strip().splitlines() or ["out of memory"])[0]
        _fail(f"{reason}; expected a smaller --batch, --rows, --points or --width, or fewer --workers", 1)
    except OSError as error:
        _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", 1)
    except TyperException as error:
        _fail(" ".join(error.format_message().split()), 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; the same command with --resume goes on from the last checkpoint", INTERRUPTED)


def _fail(line: str, status: int) -> None:
    if line:  # without arguments the help has been printed already
        print(f"trainer: {line}", file=sys.stderr)
    sys.exit(status)
