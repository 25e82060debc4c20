"""``datafactory scenes``, ``check``, ``view``, ``inspect`` and ``doctor``: what is there, and what becomes of it."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from datafactory.api.options import CheckOptions, InspectOptions, ViewOptions
from shared.cli.console import plain_console, table
from shared.cli.options import asking
from shared.physics.errors import InputError

if TYPE_CHECKING:
    from datafactory.inspection.dataset import Summary
    from datafactory.inspection.doctor import Finding
    from datafactory.inspection.scene import SceneReport
    from shared.dataset.folder import Dataset

TABLE_WIDTH = 120
MOST_FILMS = 3
"""Animations that are drawn: one a split, where each has a sequence."""


def scenes() -> None:
    """List the scenes that this package and Sionna ship, by the names that --scene takes."""
    from datafactory.scenes.readers.open import named_scenes

    rows = [(item.name, item.kind, f"{item.bytes / 1e3:.0f}", item.about) for item in named_scenes()]
    plain_console(narrowest=TABLE_WIDTH).print(table("scenes", ("--scene", "format", "[kB]", "what it is"), rows))


@asking(CheckOptions)
def check(asked: CheckOptions) -> None:
    """Say what a scene holds, what is dropped and why, and what the radar will not see; nothing is traced."""
    from datafactory.api.asking import load_scene, materials_of, scenes_of
    from datafactory.inspection.scene import examine_scene

    if asked.scene is None:
        raise InputError("--scene", "missing", "a scene file, shipped:NAME or sionna:NAME")
    (scene,) = scenes_of(asked.scene, asked, asked.seed)
    report = examine_scene(load_scene(scene), materials_of(asked.materials))
    if asked.json:
        typer.echo(json.dumps(asdict(report), indent=2))
        return
    _show_scene(report)


def _show_scene(report: SceneReport) -> None:
    console = plain_console(narrowest=TABLE_WIDTH)
    x, y, z = report.size_m
    console.print(
        f"{report.source or report.name}: {report.objects} objects, {report.triangles} triangles, "
        f"{report.point_targets} point targets; {x:.4g} x {y:.4g} x {z:.4g} m (x, y, z)"
    )
    rows = [
        (
            item.name or "(none)", item.material, item.rule if item.known else f"unknown: {item.rule}",
            str(item.objects), str(item.triangles), f"{item.area_m2:.1f}",
        )
        for item in report.materials
    ]  # fmt: skip
    console.print(table("materials", ("in the file", "taken as", "why", "objects", "triangles", "area [m2]"), rows))
    moving = [
        (
            item.kind, str(item.parts), f"{item.fastest_mps:.2f}",
            "-" if item.rests_from_s is None else f"{item.rests_from_s:g}",
        )
        for item in report.motions
    ]  # fmt: skip
    if moving:
        console.print(table("what moves", ("how", "parts", "fastest [m/s]", "rests from [s]"), moving))
    else:
        console.print("nothing moves")
    areas = ", ".join(f"{split} {area:.0f}" for split, area in report.ground_m2.items())
    console.print(f"free ground to draw a sensor on [m2]: {areas}")
    for heading, lines in (("dropped or taken otherwise", report.dropped), ("what to know", report.remarks)):
        console.print(f"{heading}: {'' if lines else 'nothing'}")
        for line in lines:
            console.print(f"  {line}")


@asking(ViewOptions)
def view(asked: ViewOptions) -> None:
    """Show a scene in three dimensions: materials, sensor, field of view, what moves, and the strongest paths.

    The frame is the one that `datafactory render` makes of the same arguments.
    """
    from datafactory.api import viewing
    from shared.cli.progress import bars

    console = plain_console()
    with bars(console, transient=True) as advance:
        written = viewing.view(**{**vars(asked), "announce": console.print, "progress": advance})
    for path in written:
        console.print(f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB")


@asking(InspectOptions)
def inspect(asked: InspectOptions) -> None:
    """Summarise a dataset, check its files and draw some of its frames; a sequence as an animation.

    Exit status 1: --verify found damaged files.
    """
    from datafactory.inspection.dataset import summarise
    from datafactory.inspection.pictures import write_animations, write_pictures
    from datafactory.view.camera import Cameras
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
        print(json.dumps(asdict(summary), indent=2))
        return
    for item in _tables(summary):
        console.print(item)
    if not dataset.splits:
        typed = shlex.quote(str(dataset.path))
        console.print(f"traced paths and no frames; next: datafactory render --paths {typed} --out OTHER")
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
    from datafactory.inspection.dataset import MEANINGS
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
    kinds = sorted({kind for counted in summary.frames.values() for kind in counted})
    by_split = []
    for split in SPLITS:
        row = [summary.frames.get(split, {}).get(kind, 0) for kind in kinds]
        by_split.append((split, *map(str, row), str(sum(row))))
    by_scene = [(scene, str(count)) for scene, count in summary.scenes.items()]
    return [
        table("Frames", ("split", *kinds, "frames"), by_split),
        table("Scenes", ("scene", "frames"), by_scene),
        table("Contents", ("what", "value"), [("radar", summary.radar), *contents]),
    ]


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON and nothing else.")] = False,
) -> None:
    """Print what this machine has, what is missing, and the command that mends it.

    Exit status 1: something is missing without which the data factory cannot work.
    """
    from datafactory.inspection.doctor import examine

    findings = examine()
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        rows = [(_mark(finding), finding.item, finding.value, finding.remedy) for finding in findings]
        plain_console().print(table("datafactory doctor", ("", "item", "found", "remedy"), rows))
    if any(finding.required and not finding.ok for finding in findings):
        raise typer.Exit(1)


def _mark(finding: Finding) -> str:
    return "ok" if finding.ok else ("MISSING" if finding.required else "note")
