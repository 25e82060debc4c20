"""The trainer's command line, as a user types it."""

from __future__ import annotations

import sys

import pytest

from trainer.cli.app import main


def status(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: object
) -> tuple[int, str, str]:
    """(exit status, standard output, standard error) of ``trainer`` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["trainer", *map(str, arguments)])
    code: object = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code or 0
    assert isinstance(code, int)
    said = capsys.readouterr()
    return code, said.out, said.err
