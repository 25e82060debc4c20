"""How commands show what they do and print what they found.

Rich takes text in square brackets for markup, so that "[dB]" would vanish from a heading and "[0]" from a scene's name.
The console of this module reads no markup and no emoji codes, neither in lines nor in tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from shared.physics.errors import printable


def plain_console(stderr: bool = False, narrowest: int = 0) -> Console:
    """The console of a command.

    :param stderr: print on standard error, where standard output carries data
    :param narrowest: columns that a table needs; in a narrower terminal its lines wrap, not its cells
    """
    console = Console(stderr=stderr, markup=False, emoji=False, highlight=False, soft_wrap=True)
    if console.width < narrowest:
        console.width = narrowest
    return console


def table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """A table for :func:`plain_console`; columns whose heading states a unit hold numbers and are right-aligned.

    :param headings: one for each column, a unit in square brackets
    :param rows: one string for each column; long ones continue on the next line, and nothing is cut off
    """
    shown = Table(title=title, title_justify="left")
    for heading in headings:
        shown.add_column(heading, justify="right" if heading.endswith("]") else "left", overflow="fold")
    for row in rows:
        shown.add_row(*map(printable, row))
    return shown
