"""``datafactory`` as a command: what it says when it is interrupted or given what it does not know."""

import sys

import pytest

from datafactory.cli.app import main


def interrupted() -> None:
    raise KeyboardInterrupt


def test_an_interrupted_command_says_how_to_go_on(capsys, monkeypatch):
    """As typer hands it on, which swallows Ctrl-C of its own accord."""
    monkeypatch.setattr("datafactory.cli.doctor.examine", interrupted)
    monkeypatch.setattr(sys, "argv", ["datafactory", "doctor"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 130
    assert capsys.readouterr().err == (
        "datafactory: interrupted; what was finished is kept: the same command with --resume goes on\n"
    )
