"""``datafactory doctor``: what this machine has, what is missing, and the command that mends it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from datafactory.cli.tables import plain_console, table

if TYPE_CHECKING:
    from datafactory.inspection.doctor import Finding


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON and nothing else.")] = False,
) -> None:
    """Print what this machine has, what is missing, and the command that mends it.

    Exit status 1: something is missing without which the data factory cannot work.
    """
    from datafactory.inspection.doctor import examine

    findings = examine()
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        rows = [(_mark(finding), finding.item, finding.value, finding.remedy) for finding in findings]
        plain_console().print(table("datafactory doctor", ("", "item", "found", "remedy"), rows))
    if any(finding.required and not finding.ok for finding in findings):
        raise typer.Exit(1)


def _mark(finding: Finding) -> str:
    return "ok" if finding.ok else ("MISSING" if finding.required else "note")
