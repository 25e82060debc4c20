"""Run the catalogue of hard cases; print its table and, if wanted, write it as Markdown.

    python tests/hardcases/run.py [--only WORD] [--markdown FILE]

Exit status 1 if any bound is broken. A case that hangs ends the run with a traceback.
"""

from __future__ import annotations

import faulthandler
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

sys.path.append(str(Path(__file__).resolve().parents[1]))

from hardcases.case import Verdict, catalogue, judge
from threadpoolctl import threadpool_limits

HANG_SECONDS = 300.0
"""No case takes a twentieth of it, compilation included."""
PAGE_WIDTH = 160
"""Columns of the table where no terminal says how many it has."""

HEAD = """# Hard cases

What breaks radar simulators and estimators: {count} cases, each with its hazard, its bound and what was measured.
Each is rendered within its bound; what cannot be rendered is refused with one line (`make fuzz`).

    make hardcases

prints this table:
"""


def figure(value: float) -> str:
    """A number as the table shows it."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def table_of(verdicts: Sequence[Verdict]) -> Table:
    """The table for the terminal."""
    table = Table("theme", "case", "hazard", "bound", "measured", "verdict", title="Hard cases")
    for verdict in verdicts:
        case = verdict.case
        judged = "[green]kept[/]" if verdict.kept else "[red]broken[/]"
        bound = f"{figure(case.bound)} {case.unit}"
        table.add_row(verdict.theme, case.name, case.hazard, bound, figure(verdict.measured), judged)
    return table


def markdown_of(verdicts: Sequence[Verdict]) -> str:
    """The same as a page of the manual."""
    lines = [HEAD.format(count=len(verdicts)), "| case | hazard | bound | measured |", "|---|---|---|---|"]
    for verdict in verdicts:
        case = verdict.case
        measured = figure(verdict.measured) + ("" if verdict.kept else " **broken**")
        lines.append(f"| {case.name} | {case.hazard} | {figure(case.bound)} {case.unit} | {measured} |")
    return "\n".join(lines) + "\n"


def run(
    only: Annotated[str, typer.Option(help="Only cases with this word in theme or name.")] = "",
    markdown: Annotated[Path | None, typer.Option(help="File for a Markdown table.", show_default=False)] = None,
) -> None:
    """Run the catalogue of hard cases."""
    console = Console(soft_wrap=True, highlight=False, width=None if sys.stdout.isatty() else PAGE_WIDTH)
    verdicts = []
    chosen = [(theme, case) for theme, case in catalogue() if only in theme or only in case.name]
    with threadpool_limits(limits=1, user_api="blas"):
        for theme, case in chosen:
            faulthandler.dump_traceback_later(HANG_SECONDS, exit=True)
            verdicts.append(judge(theme, case))
            faulthandler.cancel_dump_traceback_later()
    console.print(table_of(verdicts))
    broken = [verdict for verdict in verdicts if not verdict.kept]
    for verdict in broken:
        console.print(f"{verdict.case.name}: {verdict.fault}", markup=False)
    if markdown is not None:
        markdown.write_text(markdown_of(verdicts), encoding="utf-8")
    console.print(f"{len(verdicts) - len(broken)} of {len(verdicts)} bounds kept", markup=False)
    if broken or not verdicts:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(run)
