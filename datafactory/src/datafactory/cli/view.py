"""``datafactory view``: the scene, the sensor and the strongest paths, in three dimensions."""

from __future__ import annotations

from datafactory.api.options import ViewOptions
from datafactory.cli import options
from datafactory.cli.progress import shown
from datafactory.cli.tables import plain_console


@options.asking(ViewOptions)
def view(asked: ViewOptions) -> None:
    """Show a scene in three dimensions: materials, sensor, field of view, what moves, and the strongest paths.

    The frame is the one that `datafactory render` makes of the same arguments.
    """
    from datafactory.api import viewing

    console = plain_console()
    with shown(console, transient=True) as advance:
        written = viewing.view(**{**vars(asked), "announce": console.print, "progress": advance})
    for path in written:
        console.print(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB")
