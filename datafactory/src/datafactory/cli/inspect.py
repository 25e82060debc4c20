"""``datafactory inspect``: a dataset's numbers, checksums and pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from datafactory.api.options import InspectOptions
from datafactory.cli.options import asking
from datafactory.cli.tables import plain_console, table

if TYPE_CHECKING:
    from datafactory.inspection.dataset import Summary
    from shared.dataset.folder import Dataset


MOST_FILMS = 3
"""Animations that are drawn: one a split, where each has a sequence."""


@asking(InspectOptions)
def inspect(asked: InspectOptions) -> None:
    """Summarise a dataset, check its files and draw some of its frames; a sequence as an animation.

    Exit status 1: --verify found damaged files.
    """
    from datafactory.inspection.animation import write_animations
    from datafactory.inspection.dataset import summarise
    from datafactory.inspection.pictures import write_pictures
    from datafactory.view.cameras import Cameras
    from shared.dataset.folder import open_dataset
    from shared.dataset.folder import verify as verify_dataset
    from shared.dataset.locations import RemotePath

    console = plain_console(stderr=asked.json)
    dataset = open_dataset(asked.directory, check_sizes=not asked.verify)
    if asked.verify:
        faults = verify_dataset(dataset)
        for fault in faults:
            console.print(f"{dataset.path}/{fault}")
        if faults:
            console.print(f"{len(faults)} of {len(dataset.records)} shards or files are not as they were written")
            raise typer.Exit(1)
        console.print(f"{len(dataset.records)} shards are as they were written")
        if isinstance(dataset.path, RemotePath) and not dataset.path.lists:
            console.print("a web server lists no folder: files that the manifest does not name were not looked for")
    summary = summarise(dataset)
    if asked.json:
        print(json.dumps(summary.to_json(), indent=2))
        return
    for shown in _tables(summary):
        console.print(shown)
    if not dataset.splits:
        console.print(f"traced paths and no frames; next: datafactory render --paths {dataset.path} --out OTHER")
    if asked.frames and dataset.splits:
        folder = asked.out or _picture_folder(dataset)
        if asked.out is None and not isinstance(dataset.path, Path):
            console.print(f"the dataset is remote: its pictures go to {folder}, or to the folder that --out names")
        cameras = Cameras(dataset) if asked.camera else None
        for picture in write_pictures(dataset, asked.frames, folder, cameras):
            console.print(f"wrote {picture}")
        for film in (
            write_animations(dataset, min(asked.frames, MOST_FILMS), folder, cameras) if summary.sequences else ()
        ):
            console.print(f"wrote {film}")


def _picture_folder(dataset: Dataset) -> Path:
    from shared.dataset.locations import folder_name

    if isinstance(dataset.path, Path):
        return dataset.path / "pictures"
    return Path(f"{folder_name(dataset.path)}-pictures")


def _tables(summary: Summary) -> list[Table]:
    from datafactory.run.counts import MEANINGS
    from shared.dataset.folder import SPLITS

    contents = [(name, " x ".join(map(str, shape))) for name, shape in summary.shapes.items()]
    contents.append(("shards", f"{summary.shards}, {summary.bytes / 1e6:.1f} MB"))
    contents += [(f"count: {MEANINGS.get(name, name)}", str(count)) for name, count in summary.counts.items()]
    if summary.sequences:
        contents.insert(0, ("sequences", str(summary.sequences)))
    if summary.traced:
        contents.insert(0, ("frames of traced paths", str(summary.traced)))
    if not summary.frames:
        return [table("Contents", ("what", "value"), contents)]
    kinds = sorted({kind for _, kind in summary.frames})
    by_split = []
    for split in SPLITS:
        row = [summary.frames.get((split, kind), 0) for kind in kinds]
        by_split.append((split, *map(str, row), str(sum(row))))
    by_scene = [(scene, str(count)) for scene, count in summary.scenes.items()]
    return [
        table("Frames", ("split", *kinds, "frames"), by_split),
        table("Scenes", ("scene", "frames"), by_scene),
        table("Contents", ("what", "value"), [("radar", summary.radar), *contents]),
    ]
