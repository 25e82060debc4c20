"""``datafactory trace``: multipath alone, to render radars from later."""

from __future__ import annotations

from functools import partial

from datafactory.api.options import TraceOptions
from datafactory.cli import options


@options.asking(TraceOptions)
def trace(asked: TraceOptions, verbose: options.Verbose = False) -> None:
    """Trace multipath into DIR/paths; `datafactory render --paths DIR` renders any radar from it.

    Of the radar, only its wavelength matters here, and with --error-budget its antennas and resolution.
    """
    from datafactory.api import making

    options.run(partial(making.trace, **vars(asked)), verbose)
    options.next_step(
        str(asked.out), asked.shard, f"next:  datafactory render --paths {asked.out} --out ANOTHER_FOLDER"
    )
