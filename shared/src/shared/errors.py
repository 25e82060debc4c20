"""The one error a user can cause, and its one-line form."""

from __future__ import annotations


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
        super().__init__(" ".join(text.split()))
