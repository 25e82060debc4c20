"""``datafactory render``: scenes to a dataset."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from datafactory.api.options import RenderOptions
from datafactory.cli import options


@options.asking(RenderOptions)
def render(
    asked: RenderOptions,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Only say what it will take: frames, disk, memory, time; nothing is written."),
    ] = False,
    verbose: options.Verbose = False,
) -> None:
    """Render frames of scenes, and close-target frames beside them, into a dataset."""
    from datafactory.api import making
    from datafactory.api.asking import order_of
    from datafactory.api.forecasting import forecast
    from shared.dataset.locations import locate

    if dry_run:
        for line in forecast(order_of(asked), locate(asked.out), asked.workers, asked.shard).lines():
            typer.echo(line)
        return
    options.run(partial(making.render, **vars(asked)), verbose)
    options.next_step(str(asked.out), asked.shard, f"look:  datafactory inspect {asked.out}")
