"""Bars of progress. Commands import this module where they run: help needs none of what draws bars."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from shared.processes.telling import Progress as Advance

FRAMES = "frames"
"""The stage whose speed is shown."""
SPEED_OVER_S = 600.0
"""The speed is a mean over so long: frames of different scenes take different times."""


class _Done(ProgressColumn):
    """How much is done, of how much; nothing as long as that is not known."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        return Text("" if task.total is None else f"{task.completed:.0f}/{task.total:.0f}")


class _Speed(ProgressColumn):
    """Frames a second, of the stage that makes frames."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        return Text(f"{task.speed:.2f} frames/s" if task.description == FRAMES and task.speed else "")


@contextmanager
def bars(console: Console, transient: bool = False) -> Iterator[Advance]:
    """Show the stages of a job, those that are over as well: what a sweep took is seen beside what the frames took.

    A stage that has another number of steps than the one before it, or that begins again, gets a row of its own.
    Otherwise it is the next name for the same row.

    :param transient: leave nothing of it on the terminal
    """
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), _Done(), _Speed(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, speed_estimate_period=SPEED_OVER_S, transient=transient) as progress:
        row = progress.add_task("opening", total=None)
        before: tuple[int, int] | None = None

        def advance(stage: str, done: int, total: int) -> None:
            nonlocal row, before
            if before is None:
                progress.reset(row, description=stage, total=total)
            elif total != before[1] or done < before[0]:
                progress.stop_task(row)
                row = progress.add_task(stage, total=total)
            progress.update(row, description=stage, completed=done, total=total)
            before = done, total

        try:
            yield advance
        finally:
            if before is None:  # refused while it was opened: nothing was begun that a bar could show
                progress.remove_task(row)
