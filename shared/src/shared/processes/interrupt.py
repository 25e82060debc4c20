"""A command that is interrupted says one line, wherever it is: also while it imports what it needs."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType

INTERRUPTED = 130
"""Exit status after Ctrl-C or a request to end: 128 and the number of SIGINT."""


def run_command(program: str, load: Callable[[], Callable[[], None]]) -> None:
    """Load a command line and run it.

    A request to end (SIGTERM) is answered like Ctrl-C, so that what the command started ends with it. Libraries turn
    an interrupt within their own imports into errors of every kind: after an interrupt whatever is raised means that.

    :param program: its name, for the line
    :param load: imports the command line and returns its main function, which exits by itself
    """
    received: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        received.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        load()()
    except Exception:
        if not received:
            raise
        _say(program)
    except KeyboardInterrupt:
        _say(program)


def _say(program: str) -> None:
    print(f"{program}: interrupted", file=sys.stderr)
    sys.exit(INTERRUPTED)
