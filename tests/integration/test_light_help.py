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
before = {name.partition(".")[0] for name in sys.modules}
sys.argv = [sys.argv[1], *sys.argv[2:]]
from importlib import import_module
main = import_module(sys.argv[0] + ".cli.entry").main
try:
    main()
except SystemExit as left:
    assert not left.code, left.code
names = {name.partition(".")[0] for name in sys.modules} - before
print("IMPORTED", *sorted(name for name in names - sys.stdlib_module_names if not name.startswith("_")))
"""


def name_of(command: CommandInfo) -> str:
    """As the user types it."""
    assert command.callback is not None
    return command.name or command.callback.__name__


CASES = [
    (program, *arguments)
    for program, app in (("datafactory", datafactory), ("trainer", trainer))
    for arguments in [("--help",), *((name_of(command), "--help") for command in app.registered_commands)]
]


@pytest.mark.parametrize("words", CASES, ids=" ".join)
def test_help_imports_nothing_that_computes(words: tuple[str, ...]) -> None:
    answer = subprocess.run(
        [sys.executable, "-c", ASK, *words], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    assert "Usage:" in answer.stdout
    (line,) = [line for line in answer.stdout.splitlines() if line.startswith("IMPORTED")]
    assert set(line.split()[1:]) - OURS <= COMMAND_LINE


def test_what_computes_would_be_noticed() -> None:
    """The question finds numpy where something imports it."""
    answer = subprocess.run(
        [sys.executable, "-c", ASK.replace("main()", "import numpy"), "trainer"], capture_output=True, text=True,
        check=True, encoding="utf-8",
    )  # fmt: skip
    assert "numpy" in answer.stdout.split()
