"""Where a program begins: an interrupt is one line also while its command line, and Typer with it, is being loaded."""

from __future__ import annotations

from importlib import import_module

from shared.processes.interrupt import run_command
from shared.processes.lazy import refuse_namesake


def begin(program: str) -> None:
    """Run ``main`` of the package's ``cli.app``.

    A stranger's package of this name may have replaced our ``__init__`` and left its entry: it is asked for here too.
    """
    try:
        refuse_namesake(program)
    except ImportError as error:
        raise SystemExit(f"{program}: {error}") from None
    run_command(program, lambda: import_module(f"{program}.cli.app").main)
