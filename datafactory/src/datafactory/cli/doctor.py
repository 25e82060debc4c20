"""``datafactory doctor``: what this machine has, what is missing, and the command that mends it."""

from __future__ import annotations

import typer
from rich.console import Console
from rich.table import Table

from datafactory.inspection.doctor import examine


def doctor() -> None:
    """Print what this machine has, what is missing, and the command that mends it."""
    findings = examine()
    table = Table(title="datafactory doctor")
    for heading in ("", "item", "found", "remedy"):
        table.add_column(heading, overflow="fold")
    for finding in findings:
        mark = "ok" if finding.ok else ("MISSING" if finding.required else "note")
        table.add_row(mark, finding.item, finding.value, finding.remedy)
    Console().print(table)
    if any(finding.required and not finding.ok for finding in findings):
        raise typer.Exit(1)
