"""How a command ends: 0 done, 1 a run that failed, 2 bad input, 130 interrupted, each of the three with one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn

from shared.physics.errors import InputError, require_utf8
from shared.processes.interrupt import INTERRUPTED

Ending = tuple[str, int]
"""A line without the program's name, empty where all has been said, and the exit status."""


def run_app(
    program: str, app: Callable[[], object], interrupted: str, ending_of: Callable[[Exception], Ending | None]
) -> NoReturn:
    """Run a command line and exit.

    :param program: its name, before every line
    :param app: parses the arguments, does the work, returns the exit status
    :param interrupted: what is said after Ctrl-C
    :param ending_of: the ending that an error of the program's own means; None leaves its traceback
    """
    try:
        for argument in sys.argv[1:]:
            require_utf8(argument)
        status = app()
        if status != INTERRUPTED:  # how typer hands on Ctrl-C
            sys.exit(status)  # type: ignore[arg-type]
        line, code = interrupted, INTERRUPTED
    except KeyboardInterrupt:
        line, code = interrupted, INTERRUPTED
    except InputError as error:
        line, code = str(error), 2
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


def ending_with(examples: tuple[str, ...]) -> str:
    """The end of a command's help. Typer joins the lines of a paragraph: each example is one."""
    return "\n\n".join(("Examples:", *examples))
