"""``datafactory convert``: a dataset in another layout."""

from __future__ import annotations

from datafactory.api.options import ConvertOptions
from datafactory.cli.options import asking
from datafactory.cli.progress import shown
from datafactory.cli.tables import plain_console


@asking(ConvertOptions)
def convert(asked: ConvertOptions) -> None:
    """Write a dataset in another layout, and say what has no place in it."""
    from datafactory.api.converting import convert as run

    console = plain_console()
    with shown(console, transient=True) as advance:
        converted = run(**{**vars(asked), "progress": advance})
    console.print(f"{converted.frames} frames in {converted.directory}")
    for note in converted.notes:
        console.print(f"  {note}")
