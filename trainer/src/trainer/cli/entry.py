"""Where ``trainer`` begins: an interrupt is one line also while the command line itself is being loaded."""

from __future__ import annotations

from collections.abc import Callable

from shared.processes.interrupt import run_command


def main() -> None:
    """Run the command line."""
    run_command("trainer", _loaded)


def _loaded() -> Callable[[], None]:
    from trainer.cli.app import main

    return main
