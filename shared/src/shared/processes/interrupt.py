"""A command that is interrupted says so in one line wherever it is: also while it imports what it needs."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

from shared.processes.lazy import refuse_namesake

INTERRUPTED = 130
"""Exit status after Ctrl-C or a request to end: 128 and the number of SIGINT."""
AGAIN_S = 0.01
"""After an interrupt that nobody could catch; callbacks of C code take less."""


class _Interrupts:
    """Those that this process received.

    :param held: how many blocks hold them back
    """

    held: int = 0
    received: int = 0
    waiting: bool = False


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold back an interrupt of :func:`run_command` until the end of the block, for code that would swallow it.

    :raises KeyboardInterrupt: at the end of the block, if there was one
    """
    _Interrupts.held += 1
    try:
        yield
    finally:
        _Interrupts.held -= 1
        if _Interrupts.waiting and not _Interrupts.held:
            _Interrupts.waiting = False
            raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    _Interrupts.received += 1
    if _Interrupts.held:
        _Interrupts.waiting = True
    else:
        raise KeyboardInterrupt


def _not_raised(unraisable: sys.UnraisableHookArgs) -> None:
    """What a callback of C code or a destructor raised: nobody catches it. An interrupt comes again once it is over."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)


def begin(program: str) -> None:
    """Where a program begins: run ``main`` of the package's ``cli.app``.

    A stranger's package of this name may have replaced our ``__init__`` and left its entry: it is asked for here too.
    """
    try:
        refuse_namesake(program)
    except ImportError as error:
        raise SystemExit(f"{program}: {error}") from None
    run_command(program, lambda: import_module(f"{program}.cli.app").main)


def run_command(program: str, load: Callable[[], Callable[[], None]]) -> None:
    """Load a command line and run it.

    A request to end (SIGTERM) is answered like Ctrl-C, so that what the command started ends with it. Libraries turn
    an interrupt within their own imports into errors of every kind: after an interrupt whatever is raised means that.

    :param program: its name, for the line
    :param load: imports the command line and returns its main function, which exits by itself
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, _interrupt)
    sys.unraisablehook = _not_raised
    try:
        load()()
    except Exception:
        if not _Interrupts.received:
            raise
        _say(program)
    except KeyboardInterrupt:
        _say(program)
    finally:
        # Where an interrupt ends code that a library runs by PyRun_String, CPython notes it, and ends the process by
        # the signal instead of our status though it was caught. The next code that is run so takes the note back.
        if _Interrupts.received:
            import ctypes  # where needed: few commands are interrupted

            ctypes.pythonapi.PyRun_SimpleString(b"")


def _say(program: str) -> None:
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    print(f"{program}: interrupted", file=sys.stderr)
    sys.exit(INTERRUPTED)
