"""``datafactory merge``: the jobs of an array to one dataset."""

from __future__ import annotations

from functools import partial

import typer

from datafactory.api.options import MergeOptions
from datafactory.cli import options


@options.asking(MergeOptions)
def merge(asked: MergeOptions, verbose: options.Verbose = False) -> None:
    """Join the jobs of an array into one dataset: the shards and the manifest of the run in one piece.

    Shards are linked where the jobs lie on the same disk, and copied where not.
    """
    from datafactory.api import merging

    options.run(partial(merging.merge, **vars(asked)), verbose)
    typer.echo(f"look:  datafactory inspect {asked.out}")
