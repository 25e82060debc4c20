"""The sweep as a table, as files, and as a picture of error against time."""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter

from datafactory.accuracy.errors import FLOOR_DB
from datafactory.accuracy.sweep import DEFAULTS, Row
from datafactory.effects.catalogue import EffectSet
from shared.dataset.writing import atomic

HEADINGS = (
    "knob", "setting", "s/frame", "cube dB", "image dB", "image L2 dB", "cell L1 dB", "L1 r^4 dB", "bias dB",
    "detections %", "rows %", "peak MB", "paths", "work",
)  # fmt: skip
EXPLANATION = (
    "A frame on one core, median seconds: trace and write on the wall clock, the rest in processor time. "
    "* is the default. Errors are the largest over the frames.",
    "Signal knobs, on the same paths: cube is relative L2; image the largest difference over the peak, in the same "
    "Doppler cells. They are varied around an unpruned cube at 1e-6 and a truth of 6 terms.",
    "Power knobs change the paths, and the ray count changes the speckle realisation. Measured is the power in a "
    "resolution cell, summed over its paths without phase, of one realisation of the rays against its average over "
    "realisations of many more: cube and image L2 are relative L2 of the amplitudes, rms over realisations, "
    "image is the largest difference over the peak, mean over realisations, the reference's own variance subtracted; "
    "cell L1 is sum |P - P_ref| / sum P_ref, mean over realisations, L1 r^4 the same weighted by range^4; bias is of "
    "the total power. Sphere rays are those of the solver's own lattice, of which the front half counts as it does for "
    "the fan; lattice all around is what the fan's half space leaves out. Depth, surfaces and effects are held against "
    "the default with the same rays (depth against the deepest). surface_phase turns phases alone: it has no error in "
    "power. The change in detections contains that of speckle.",
    "rows: Doppler cells chosen otherwise, among rows with a detection. Peak: growth of the resident set in any stage. "
    "Work: counted multiply-adds.",
)
MARKERS = "osD^vPXph<>d8H"
COLORS = ("C0", "C1", "C2", "C4", "C5", "C6", "C7", "C8", "C9", "black", "teal", "olive", "navy")
"""Without red, which is the default's."""
LABELS_APART = 0.02
"""Least distance between labels, as a share of the errors' span."""
TRUTH_ALONE = ("truth_terms", "truth_wave", "truth_window")
CUBE_ALONE = ("tolerance", "near_field", "video_phase")
"""Knobs that leave the other of the two as it is; each is drawn where it acts."""


def table_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The rows as text under HEADINGS."""
    return [
        (
            row.knob,
            row.setting + (" *" if row.default else ""),
            f"{row.seconds:.2f}",
            f"{row.cube_error_db:.1f}",
            f"{row.image_error_db:.1f}",
            f"{row.image_l2_db:.1f}",
            "" if row.power_l1_db is None else f"{row.power_l1_db:.1f}",
            "" if row.power_l1_range_weighted_db is None else f"{row.power_l1_range_weighted_db:.1f}",
            f"{row.power_bias_db:+.3f}",
            f"{row.detections_changed:.1f}",
            f"{row.doppler_rows_changed:.1f}",
            f"{row.peak_mb:.0f}",
            f"{row.paths:.0f}",
            f"{row.work:.2e}",
        )
        for row in rows
    ]


def write_tables(rows: Sequence[Row], directory: Path) -> list[Path]:
    """``accuracy.parquet`` and ``accuracy.csv``; in the latter ``stage_seconds`` is JSON.

    :raises OSError: the folder cannot be written
    """
    parquet, text = directory / "accuracy.parquet", directory / "accuracy.csv"
    with atomic(parquet) as partial:
        pq.write_table(pa.Table.from_pylist([asdict(row) for row in rows]), partial)
    with atomic(text) as partial, partial.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, [item.name for item in fields(Row)])
        writer.writeheader()
        writer.writerows({**asdict(row), "stage_seconds": json.dumps(row.stage_seconds)} for row in rows)
    return [parquet, text]


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points (seconds, error) that no other point beats in both, seconds rising and error falling."""
    front: list[tuple[float, float]] = []
    for seconds, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((seconds, error))
    return front


def draw(rows: Sequence[Row], title: str) -> Figure:
    """Error against time: cube and image on the same paths, and power in a resolution cell."""
    figure = Figure(figsize=(17.0, 6.2), layout="constrained")
    axes = figure.subplots(1, 3)
    # At the floor a power setting is its own reference: there is nothing to draw.
    power = [row for row in rows if row.kind == "power" and row.image_error_db > FLOOR_DB]
    cube = [row for row in rows if row.kind == "signal" and row.knob not in TRUTH_ALONE]
    truth = [row for row in rows if row.kind == "signal" and row.knob not in CUBE_ALONE]
    styles = _styles(rows)
    _panel(axes[0], cube, [row.cube_error_db for row in cube], styles, "cube, same paths: relative L2 error [dB]")
    _panel(
        axes[1], truth, [row.image_error_db for row in truth], styles, "truth, same paths: largest error over peak [dB]"
    )
    _panel(
        axes[2],
        power,
        [row.image_error_db for row in power],
        styles,
        "amplitude in a cell, of its mean: error over peak [dB]",
    )
    figure.suptitle(title)
    return figure


def _styles(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Marker and colour of every knob, the same in all panels."""
    styles: dict[str, dict[str, Any]] = {
        knob: {"marker": MARKERS[number % len(MARKERS)], "color": COLORS[number % len(COLORS)], "markersize": 6}
        for number, knob in enumerate(dict.fromkeys(row.knob for row in rows))
    }
    return {**styles, DEFAULTS: {"marker": "*", "color": "tab:red", "markersize": 17}}


def _panel(
    axis: Axes, rows: Sequence[Row], errors: Sequence[float], styles: dict[str, dict[str, Any]], label: str
) -> None:
    points = [(row.seconds, error) for row, error in zip(rows, errors, strict=True)]
    front = pareto_front([point for row, point in zip(rows, points, strict=True) if row.approximation])
    if front:
        axis.step(*zip(*front, strict=True), where="post", color="tab:blue", lw=1.2, label="Pareto front", zorder=1)
    for knob in dict.fromkeys(row.knob for row in rows):
        mine = [index for index, row in enumerate(rows) if row.knob == knob]
        default, added = knob == DEFAULTS, not all(rows[index].approximation for index in mine)
        axis.plot(
            [points[index][0] for index in mine],
            [points[index][1] for index in mine],
            linestyle="none",
            markerfacecolor="none" if added else styles[knob]["color"],
            label="default" if default else f"{knob}, added to the plan" if added else knob,
            zorder=3 if default else 2,
            **styles[knob],
        )
    labelled = list[tuple[float, float]]()
    span = max(errors, default=0.0) - min(errors, default=0.0)
    for row, point in zip(rows, points, strict=True):
        # Points of the front that lie on one another share the first one's label.
        apart = all(abs(point[1] - other[1]) > LABELS_APART * span for other in labelled)
        if point in front and row.knob != DEFAULTS and apart:
            labelled.append(point)
            axis.annotate(f"{row.knob} {row.setting}", point, xytext=(5, 4), textcoords="offset points", fontsize=7)
    axis.margins(x=0.2)
    axis.set(xscale="log", xlabel="seconds a frame, one core", ylabel=label)
    for formatter in (axis.xaxis.set_major_formatter, axis.xaxis.set_minor_formatter):
        formatter(FormatStrFormatter("%.3g"))
    axis.grid(True, which="both", alpha=0.25)
    axis.legend(fontsize=7, loc="best")


def write_picture(rows: Sequence[Row], title: str, directory: Path) -> Path:
    """``accuracy.png``.

    :raises OSError: the folder cannot be written
    """
    path = directory / "accuracy.png"
    with atomic(path) as partial:
        draw(rows, title).savefig(partial, format="png", dpi=110, metadata={"Software": None})
    return path


def effects_line(effects: EffectSet, absent: Collection[str]) -> str:
    """What the frames are simulated with, and which effects have no row because the scene has nothing for them."""
    text = f"Effects as planned: {', '.join(effects.names)}. An effect's row is the other way round."
    return f"{text} Nothing in the scene for: {', '.join(sorted(absent))}." if absent else text
