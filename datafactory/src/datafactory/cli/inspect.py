"""``datafactory inspect``: a dataset's numbers, checksums and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from datafactory.inspection.dataset import Summary, summarise, summarise_traced, write_pictures
from shared.dataset.folder import SPLITS, open_dataset
from shared.dataset.folder import verify as verify_dataset


def inspect(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a finished dataset.", show_default=False)],
    verify: Annotated[
        bool, typer.Option("--verify", help="Check every byte against the manifest's checksums.")
    ] = False,
    frames: Annotated[int, typer.Option(min=0, help="Pictures to draw, of frames spread over the dataset.")] = 4,
    out: Annotated[Path | None, typer.Option(help="Folder of the pictures; DIR/pictures by default.")] = None,
) -> None:
    """Summarise a dataset, check its files and draw some of its frames.

    Exit status 1: --verify found damaged files.
    """
    console = Console(soft_wrap=True, highlight=False)
    dataset = open_dataset(directory, check_sizes=not verify)
    if verify:
        faults = verify_dataset(dataset)
        for fault in faults:
            console.print(f"{directory}/{fault}", markup=False)
        if faults:
            console.print(f"{len(faults)} of {len(dataset.records)} shards or files are not as they were written")
            raise typer.Exit(1)
        console.print(f"{len(dataset.records)} shards are as they were written")
    if not dataset.splits:
        console.print(summarise_traced(dataset), markup=False)
        return
    for table in _tables(summarise(dataset)):
        console.print(table)
    if frames:
        for picture in write_pictures(dataset, frames, out or directory / "pictures"):
            console.print(f"wrote {picture}", markup=False)


def _tables(summary: Summary) -> list[Table]:
    kinds = sorted({kind for _, kind in summary.frames})
    by_split = Table("split", *kinds, "frames", title="Frames", title_justify="left")
    for split in SPLITS:
        row = [summary.frames.get((split, kind), 0) for kind in kinds]
        by_split.add_row(split, *map(str, row), str(sum(row)))
    by_scene = Table("scene", "frames", title="Scenes", title_justify="left")
    for scene, count in summary.scenes.items():
        by_scene.add_row(scene, str(count))
    about = Table("what", "value", title="Contents", title_justify="left")
    about.add_row("radar", summary.radar)
    for name, shape in summary.shapes.items():
        about.add_row(name, " x ".join(map(str, shape)))
    about.add_row("shards", f"{summary.shards}, {summary.bytes / 1e6:.1f} MB")
    for name, count in summary.counts.items():
        about.add_row(f"count: {name}", str(count))
    return [by_split, by_scene, about]
