"""``datafactory`` and ``trainer`` as the shell runs them, in this process."""

import contextlib
import io
import sys
from importlib import import_module

import pytest


def ended(program: str, *arguments: object) -> tuple[int, str, str]:
    """(exit status, standard output, standard error) of the command with these arguments."""
    main = import_module(f"{program}.cli.app").main  # here: neither program's tests load the other one
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            main()
    return int(left.value.code or 0), out.getvalue(), err.getvalue()


def refused(program: str, *arguments: object) -> str:
    """The one line with which the command says that it cannot be run so."""
    status, _, line = ended(program, *arguments)
    assert (status, line.count("\n")) == (2, 1), line
    return line
