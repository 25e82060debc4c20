"""``datafactory convert``: a dataset in another layout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.cli.progress import shown
from datafactory.cli.tables import plain_console


def convert(
    directory: Annotated[
        str,
        typer.Argument(metavar="DIR", help="Folder of a finished dataset, also s3:// or gs://.", show_default=False),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="raddet: RADDet's folders, of a dataset with cubes; mcap: files for Foxglove.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write; it must not exist yet.", show_default=False)],
) -> None:
    """Write a dataset in another layout, and say what has no place in it."""
    from datafactory.api.converting import convert as run

    console = plain_console()
    with shown(console, transient=True) as advance:
        converted = run(directory, out, to=to, progress=advance)
    console.print(f"{converted.frames} frames in {converted.directory}")
    for note in converted.notes:
        console.print(f"  {note}")
