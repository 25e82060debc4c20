"""How a command ends: 0 done, 1 a run that failed, 2 bad input, 130 interrupted, each of the three with one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn

import typer
from typer.exceptions import TyperException

from shared.physics.errors import InputError, require_utf8
from shared.processes.interrupt import INTERRUPTED

Ending = tuple[str, int]
"""A line without the program's name, empty where all has been said, and the exit status."""


class Interrupted(Exception):
    """Ctrl-C in a command without ``--resume``; its text says what to do.

    :param into: what running it again needs
    """

    def __init__(self, into: str = "") -> None:
        super().__init__(f"interrupted; it has no --resume: run it again{into}")


def run_app(
    program: str, app: Callable[..., object], stopped: str, ending_of: Callable[[Exception], Ending | None]
) -> NoReturn:
    """Run a command line and exit.

    :param program: its name, before every line
    :param app: parses the arguments, does the work, returns the exit status
    :param stopped: what is said after Ctrl-C in a command with ``--resume``
    :param ending_of: the ending that an error of the program's own means; None leaves its traceback
    """
    try:
        for argument in sys.argv[1:]:
            require_utf8(argument)
        status = app(standalone_mode=False)
        if status != INTERRUPTED:  # how typer hands on Ctrl-C
            sys.exit(status)  # type: ignore[arg-type]
        line, code = stopped, INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        line, code = stopped, INTERRUPTED
    except Interrupted as interrupted:
        line, code = str(interrupted), INTERRUPTED
    except InputError as error:
        line, code = str(error), 2
    except TyperException as error:  # an empty message: without arguments the help has been printed already
        line, code = " ".join(error.format_message().split()), 2
    except Exception as error:
        ending = ending_of(error)
        if ending is None and isinstance(error, OSError):
            ending = f"{error.filename or 'input/output'}: {error.strerror or error}", 1
        if ending is None:
            raise
        line, code = ending
    if line:
        print(f"{program}: {line}", file=sys.stderr)
    sys.exit(code)
