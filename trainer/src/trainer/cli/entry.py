"""Where ``trainer`` begins: an interrupt is one line also while the command line itself is being loaded."""

from __future__ import annotations

from collections.abc import Callable

from shared.processes.interrupt import run_command
from shared.processes.lazy import refuse_namesake


def main() -> None:
    """Run the command line.

    A stranger's ``trainer`` may have replaced our ``__init__`` and left this file: it is asked for here too.
    """
    try:
        refuse_namesake("trainer")
    except ImportError as error:
        raise SystemExit(f"trainer: {error}") from None
    run_command("trainer", _loaded)


def _loaded() -> Callable[[], None]:
    from trainer.cli.app import main

    return main
