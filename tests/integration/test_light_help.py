"""The command lines answer ``--help`` without what computes: no module of it is imported, so nobody waits for it."""

from __future__ import annotations

import subprocess
import sys

import pytest
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


CASES = [
    (program, *arguments)
    for program, app in (("datafactory", datafactory), ("trainer", trainer))
    for arguments in [("--help",), *((name_of(command), "--help") for command in app.registered_commands)]
]


def asked(program: str, *commands: str) -> str:
    """What a fresh interpreter prints."""
    answer = subprocess.run(
        [sys.executable, "-c", ASK, program, *commands], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    return answer.stdout


@pytest.fixture(scope="module")
def pages() -> dict[tuple[str, ...], str]:
    """Each case's page, the modules named at its end; one interpreter for a program."""
    found: dict[tuple[str, ...], str] = {}
    for program in ("datafactory", "trainer"):
        cases = [case for case in CASES if case[0] == program]
        lines = asked(program, *(" ".join(case[1:]) for case in cases)).splitlines()
        ends = [number for number, line in enumerate(lines) if line.startswith("IMPORTED")]
        starts = [0, *(end + 1 for end in ends)]
        found |= {
            case: "\n".join(lines[start : end + 1]) for case, start, end in zip(cases, starts, ends, strict=False)
        }
    return found


@pytest.mark.parametrize("words", CASES, ids=" ".join)
def test_help_imports_nothing_that_computes(words: tuple[str, ...], pages: dict[tuple[str, ...], str]) -> None:
    page, _, imported = pages[words].rpartition("IMPORTED")
    assert "Usage:" in page
    assert set(imported.split()) - OURS <= COMMAND_LINE


def test_what_computes_would_be_noticed() -> None:
    """The question finds numpy where something imports it."""
    answer = subprocess.run(
        [sys.executable, "-c", ASK.replace("main()", "import numpy"), "trainer", "--help"], capture_output=True,
        text=True, check=True, encoding="utf-8",
    )  # fmt: skip
    assert "numpy" in answer.stdout.split()
