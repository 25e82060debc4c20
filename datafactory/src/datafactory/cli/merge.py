"""``datafactory merge``: the jobs of an array to one dataset."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli import options


def merge(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="The --out of jobs made with --shard, or single jobs' folders."),
    ],
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Folder of the dataset; new or empty.")],
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a merge that was killed.")] = False,
    verbose: options.Verbose = False,
) -> None:
    """Join the jobs of an array into one dataset: the shards and the manifest of the run in one piece.

    Shards are linked where the jobs lie on the same disk, and copied where not.
    """
    from datafactory.api import merging

    options.run(partial(merging.merge, folders, out, resume=resume), verbose)
    typer.echo(f"look:  datafactory inspect {out}")
