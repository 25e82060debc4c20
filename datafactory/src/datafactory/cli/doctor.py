"""``datafactory doctor``: what this machine has, what is missing, and the command that mends it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from datafactory.cli.tables import plain_console, table

if TYPE_CHECKING:
    from datafactory.inspection.doctor import Finding


def doctor() -> None:
    """Print what this machine has, what is missing, and the command that mends it."""
    from datafactory.inspection.doctor import examine

    findings = examine()
    rows = [(_mark(finding), finding.item, finding.value, finding.remedy) for finding in findings]
    plain_console().print(table("datafactory doctor", ("", "item", "found", "remedy"), rows))
    if any(finding.required and not finding.ok for finding in findings):
        raise typer.Exit(1)


def _mark(finding: Finding) -> str:
    return "ok" if finding.ok else ("MISSING" if finding.required else "note")
