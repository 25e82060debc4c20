"""``trainer``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

import sys

import typer

from shared.errors import InputError, require_utf8
from trainer.cli.evaluate import evaluate
from trainer.cli.export import export
from trainer.cli.fit import fit
from trainer.cli.predict import predict
from trainer.errors import TrainingStopped

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
        app()
    except InputError as error:
        _fail(str(error), 2)
    except TrainingStopped as error:
        _fail(str(error), 1)
    except OSError as error:
        _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", 1)
    except KeyboardInterrupt:
        _fail("interrupted; the same command with --resume goes on from the last checkpoint", 130)


def _fail(line: str, status: int) -> None:
    print(f"trainer: {line}", file=sys.stderr)
    sys.exit(status)
