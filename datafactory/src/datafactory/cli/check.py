"""``datafactory check``: what a scene holds, what becomes of it, and what the radar will not see of it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import typer

from datafactory.api.options import CheckOptions
from datafactory.cli import options
from datafactory.cli.tables import plain_console, table
from shared.physics.errors import InputError

if TYPE_CHECKING:
    from datafactory.inspection.scene import SceneReport

TABLE_WIDTH = 120


@options.asking(CheckOptions)
def check(asked: CheckOptions) -> None:
    """Say what a scene holds, what is dropped and why, and what the radar will not see; nothing is traced."""
    from datafactory.api.asking import load_scene, materials_of, scenes_of
    from datafactory.inspection.scene import examine_scene

    if asked.scene is None:
        raise InputError("--scene", "missing", "a scene file, shipped:NAME or sionna:NAME")
    (scene,) = scenes_of(asked.scene, asked, asked.seed)
    report = examine_scene(load_scene(scene), materials_of(asked.materials))
    if asked.json:
        typer.echo(json.dumps(report.to_json(), indent=2))
        return
    _show(report)


def _show(report: SceneReport) -> None:
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
            item.kind,
            str(item.parts),
            f"{item.fastest_mps:.2f}",
            "-" if item.rests_from_s is None else f"{item.rests_from_s:g}",
        )
        for item in report.motions
    ]
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
