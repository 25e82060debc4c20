"""The command lines answer ``--help`` without what computes: no module of it is imported, so nobody waits for it."""

from __future__ import annotations

import subprocess
import sys

import pytest
import typer
from typer.models import CommandInfo

from datafactory.cli.app import app as datafactory
from trainer.cli.app import app as trainer

OURS = {"shared", "datafactory", "trainer"}
COMMAND_LINE = {
    "typer", "rich", "click", "shellingham", "pygments", "markdown_it", "mdurl", "typing_extensions", "annotated_doc",
    "attr", "colorama", "pydantic", "pydantic_core", "annotated_types", "typing_inspection",
}  # fmt: skip
"""Typer, Rich, and what they import to print a page of help; Typer checks the limits of options by pydantic."""

ASK = """
import sys
def tops():
    return {name.partition(".")[0] for name in sys.modules}
before = tops()
program, *commands = sys.argv[1:]
from importlib import import_module
main = import_module(program + ".cli.entry").main
for command in commands:
    sys.argv = [program, *command.split()]
    try:
        main()
    except SystemExit as left:
        assert not left.code, left.code
    names = tops() - before - sys.stdlib_module_names
    print("IMPORTED", *sorted(name for name in names if not name.startswith("_")))
    before = tops()
"""
"""Asks for one page of help after the other; each names what no page before it imported."""


def name_of(command: CommandInfo) -> str:
    """As the user types it."""
    assert command.callback is not None
    return command.name or command.callback.__name__


def asked(program: str, *pages: str, ask: str = ASK) -> str:
    """What a fresh interpreter prints."""
    command = [sys.executable, "-c", ask, program, *pages]
    return subprocess.run(command, capture_output=True, text=True, check=True, encoding="utf-8").stdout


@pytest.mark.parametrize(("program", "app"), [("datafactory", datafactory), ("trainer", trainer)])
def test_help_imports_nothing_that_computes(program: str, app: typer.Typer) -> None:
    pages = ["--help", *(f"{name_of(command)} --help" for command in app.registered_commands)]
    answer = asked(program, *pages)
    assert answer.count("Usage:") >= len(pages)
    imported = [line.split()[1:] for line in answer.splitlines() if line.startswith("IMPORTED")]
    for page, names in zip(pages, imported, strict=True):
        assert set(names) - OURS <= COMMAND_LINE, page


def test_what_computes_would_be_noticed() -> None:
    """The question finds numpy where something imports it."""
    assert "numpy" in asked("trainer", "--help", ask=ASK.replace("main()", "import numpy")).split()
