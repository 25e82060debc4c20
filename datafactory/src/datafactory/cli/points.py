"""``datafactory points``: close-target synthetic sets."""

from __future__ import annotations

from functools import partial

from datafactory.api.options import PointsOptions
from datafactory.cli import options


@options.asking(PointsOptions)
def points(asked: PointsOptions, verbose: options.Verbose = False) -> None:
    """Render close-target frames, the paper's synthetic set, or exactly the targets of a file."""
    from datafactory.api import making

    given = {**vars(asked), "scenes": None, "frames": 0, "points": asked.frames}
    options.run(partial(making.render, **given), verbose)
    options.next_step(str(asked.out), asked.shard, f"look:  datafactory inspect {asked.out}")
