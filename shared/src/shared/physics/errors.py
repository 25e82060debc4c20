"""What a user is told: the one error that a user can cause, in one line, and what values say of themselves."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from html import escape

LONGEST_IN_FIGURE = 60
"""Characters of a name: longer ones leave a figure no room."""


class InputError(ValueError):
    """Bad input of the user: a file, an argument or a value in it.

    The command-line layers print ``str(error)`` as a single line and exit with status 2; library callers catch it
    like any other ``ValueError``. The message names the source (file or argument), the field, the value found and
    what would be right.

    :param source: the file or argument that is wrong, e.g. ``"radar.toml"`` or ``"--frames"``
    :param problem: what is wrong, with the value, e.g. ``"waveform.chirps = 0"``
    :param expected: what would be right, e.g. ``"a whole number of at least 1"``
    """

    def __init__(self, source: object, problem: str, expected: str = "") -> None:
        text = f"{source}: {problem}"
        if expected:
            text += f"; expected {expected}"
        super().__init__(printable(" ".join(text.split())))
        self._arguments = str(source), problem, expected

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Made anew from its three parts, so that a process pool can hand it on."""
        return type(self), self._arguments


def printable(text: str) -> str:
    """Text from a file as a terminal may show it: what is no character to look at is escaped.

    Otherwise a scene's name could clear the screen, or read from right to left.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def figure_text(text: str) -> str:
    """Text from a file as Matplotlib may draw it: no formula, and not longer than :data:`LONGEST_IN_FIGURE`."""
    shown = printable(text)
    if len(shown) > LONGEST_IN_FIGURE:
        shown = f"{shown[: LONGEST_IN_FIGURE - 3]}..."
    return shown.replace("$", r"\$")


def require_utf8(path: object) -> None:
    """Refuse a path that is no text: Arrow, USD and trimesh cannot open it, and no Parquet column can name it.

    POSIX file names are bytes; Python holds what is not UTF-8 in them as lone surrogates.

    :raises InputError: naming the path with its odd characters escaped
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(ascii(str(path)), "the path is not UTF-8", "a file or folder whose name is text") from None


def meant(value: str, known: Iterable[str]) -> str:
    """``"; did you mean 'NAME'?"`` with the known name that ``value`` is like, to end a message; "" where none is."""
    near = get_close_matches(value, list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


class Told:
    """For values that a user handles: ``__str__`` is one to five lines, and a notebook shows the same lines.

    ``repr`` stays what the class makes it, with every field.
    """

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"
