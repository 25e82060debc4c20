"""Run the catalogue of hard cases and print it as a table; docs/notes/hardcases.md has the worst of each.

    python tests/hardcases/run.py [--only WORD]

Exit status 1 if any bound is broken. A case that hangs ends the run with a traceback.
"""

import faulthandler
import math
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).resolve().parents[1]))

from hardcases.case import Verdict, catalogue, judge
from threadpoolctl import threadpool_limits

HANG_SECONDS = 300.0
"""No case takes a twentieth of it, compilation included."""


def figure(value: float) -> str:
    """A number as the table shows it."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def row_of(verdict: Verdict) -> str:
    """A case's row of the Markdown table."""
    case = verdict.case
    measured = figure(verdict.measured) + ("" if verdict.kept else " **broken**")
    return f"| {case.name} | {case.hazard} | {figure(case.bound)} {case.unit} | {measured} |"


def run(only: Annotated[str, typer.Option(help="Only cases with this word in theme or name.")] = "") -> None:
    """Run the catalogue of hard cases."""
    verdicts = []
    print("| case | hazard | bound | measured |\n|---|---|---|---|")
    with threadpool_limits(limits=1, user_api="blas"):
        for theme, case in catalogue():
            if only not in theme and only not in case.name:
                continue
            faulthandler.dump_traceback_later(HANG_SECONDS, exit=True)
            verdicts.append(judge(case))
            faulthandler.cancel_dump_traceback_later()
            print(row_of(verdicts[-1]), flush=True)
    broken = [verdict for verdict in verdicts if not verdict.kept]
    for verdict in broken:
        print(f"{verdict.case.name}: {verdict.fault}")
    print(f"{len(verdicts) - len(broken)} of {len(verdicts)} bounds kept")
    if broken or not verdicts:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(run)
