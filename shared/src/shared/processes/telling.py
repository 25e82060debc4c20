"""Who is told what is done: options that a function's caller has and a command, which tells its console, has not."""

from collections.abc import Callable
from typing import Annotated, TypeAlias

from shared.processes.declared import Option, Options

Announce: TypeAlias = Callable[[str], None]
"""Takes a line for the user: how materials were mapped, what was left out, a warning."""
Progress: TypeAlias = Callable[[str, int, int], None]
"""Takes what is being done, how much of it is done, and of how much: ``("frames", 5, 8)``; with an
error budget also ``(what is measured, 7, 40)``."""


def silent(*_: object) -> None:
    """An :data:`Announce` and a :data:`Progress` that do nothing."""


class AnnouncingOptions(Options):
    announce: Annotated["Announce", Option("Takes lines for the user.", shown=False)] = silent


class TellingOptions(AnnouncingOptions):
    progress: Annotated["Progress", Option(
        "Takes what is being done, how much of it is done, and of how much.", shown=False)] = silent  # fmt: skip
