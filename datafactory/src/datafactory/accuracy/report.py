"""The price list as a table, as files, and as a picture for someone who sees it for the first time."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import groupby, zip_longest
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter

from datafactory.accuracy.knobs import Effort
from datafactory.accuracy.looking import STAGES
from datafactory.accuracy.prices import LEVELS_DB
from datafactory.accuracy.study import DEFAULTS, FRONT, Row
from shared.dataset.writing import atomic
from shared.pictures import save_figure

HEADINGS = ("knob", "setting", "s/frame", "cube dB", "image dB", "power dB", "bias dB", "paths", "work s")


def explanation(effort: Effort) -> tuple[str, ...]:
    """What the columns are."""
    return (
        "A frame on one core, median seconds: write, and trace on a GPU, on the wall clock, the rest in processor "
        "time. * is the default. Errors are the largest over the frames. Work is seconds by fixed rates, the same on "
        "every machine.",
        "tolerance, prune_db and truth_terms, on the same paths: cube is relative L2; image the largest difference "
        "over the peak, in the same Doppler cells; bias is of the image's power. They are varied around an unpruned "
        "cube at 1e-6 and a truth of 6 terms.",
        "rays and depth change the paths, and the speckle with them. Measured is the power in a resolution cell, "
        "summed over its paths without phase: power is the largest difference of amplitudes over the peak, mean over "
        f"{effort.realisations} realisations of the rays or more; bias is of the total power. Rays are held against "
        f"the mean of {effort.reference_realisations} realisations of {effort.reference_rays}, whose own variance is "
        "subtracted, depth against the deepest with the same rays.",
        "front: the cheapest settings, by work, whose three errors stay below a level, all at once. Their error of the "
        "power, and that of the defaults, is that of their rays and depth in the rows above; times are with their own "
        f"rays. It begins at {LEVELS_DB[0]:g} dB, and has no point where no setting on the menu has that.",
    )


def table_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The rows as text under HEADINGS."""

    def level(value: float | None, sign: str = "") -> str:
        return "" if value is None else f"{value:{sign}.{3 if sign else 1}f}"

    return [
        (
            row.knob,
            row.setting + (" *" if row.default else ""),
            f"{row.seconds:.2f}",
            level(row.cube_error_db),
            level(row.image_error_db),
            level(row.power_error_db),
            level(row.power_bias_db, "+"),
            f"{row.paths:.0f}",
            f"{row.work:.2f}",
        )
        for row in rows
    ]


BLUE, RED, GREY, LIGHT = "#1f5fa8", "#c4282d", "#555555", "#c9d6e6"
STAGE_NAMES = {
    "trace": "trace the rays", "delays and spread": "input cube", "range-Doppler": "range-Doppler spectra",
    "truth": "truth", "image": "truth's image", "write": "write the file",
}  # fmt: skip
RAYS_AT = {"left": (6, -14), "right": (-8, 5)}
"""Where the label of a point has its left or its right end, from the point on [points]."""
CLOSE_DB, CLOSE_RATIO = 10.0, 1.25
"""Labels on one side of points that lie no further apart would stand one over the other."""
WIDE = 8.0
"""Dearest over cheapest of a front from which on its seconds stand on a logarithmic axis."""


def draw(rows: Sequence[Row], title: str) -> Figure:
    """What accuracy costs, and where the seconds go."""
    figure = Figure(figsize=(15.0, 6.2), layout=ConstrainedLayoutEngine(w_pad=0.15, wspace=0.04))
    left, right = figure.subplots(1, 2)
    front = [row for row in rows if row.knob == FRONT]
    (usual,) = (row for row in rows if row.knob == DEFAULTS)
    _front_panel(left, front, usual)
    _stage_panel(right, front, usual)
    figure.suptitle(title, fontsize=11, color=GREY)
    return figure


def _called(usual: Row) -> str:
    """The defaults; a quick study, and one told its rays, has other rays."""
    return "the default" if usual.default else "the default but for its rays"


def _front_panel(axis: Axes, front: Sequence[Row], usual: Row) -> None:
    """Seconds over error."""
    axis.plot([row.worst_db for row in front], [row.seconds for row in front], "o-", color=BLUE, lw=2.0, ms=5)
    _rays_beside(axis, front)
    axis.plot([usual.worst_db], [usual.seconds], "*", color=RED, ms=16, zorder=4)
    axis.annotate(
        _called(usual), (usual.worst_db, usual.seconds), xytext=(-10, 6), textcoords="offset points", color=RED,
        fontsize=10, weight="bold", ha="right",
    )  # fmt: skip
    axis.invert_xaxis()
    axis.margins(x=0.25, y=0.15)
    prices = [row.seconds for row in (*front, usual)]
    if max(prices) > WIDE * min(prices):
        axis.set_yscale("log")
        axis.set_ylim(min(prices) / 2.0, max(prices) * 2.0)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    else:
        axis.set_ylim(0.0, 1.2 * max(prices))
    axis.set_xlabel("error [dB], the worst of input cube, truth image and power in a cell: better to the right")
    axis.set_ylabel("seconds a frame, one core")
    _plain(axis, "What does accuracy cost?", "both", ("top", "right"))


def _rays_beside(axis: Axes, front: Sequence[Row]) -> None:
    """The number of rays at each point where it changes: to the right, of two points close together the first's to the
    left; none where neither side has room."""
    changes = [next(same) for _, same in groupby(front, _rays)]
    taken: dict[str, Row] = {}
    for row, following in zip_longest(changes, changes[1:]):
        crowded = following is not None and _close(following, row)
        for align in ("right", "left") if crowded else ("left", "right"):
            if align not in taken or not _close(row, taken[align]):
                axis.annotate(
                    f"{_rays(row):,} rays".replace(",", " "), (row.worst_db, row.seconds), xytext=RAYS_AT[align],
                    fontsize=8, textcoords="offset points", color=BLUE, ha=align,
                )  # fmt: skip
                taken[align] = row
                break


def _rays(row: Row) -> int:
    return int(row.setting.split(": ")[1].split(" rays")[0])


def _close(row: Row, before: Row) -> bool:
    return abs(row.worst_db - before.worst_db) <= CLOSE_DB and row.seconds <= CLOSE_RATIO * before.seconds


def _stage_panel(axis: Axes, front: Sequence[Row], usual: Row) -> None:
    """Seconds of every stage: the default, and the ends of the front."""
    ends = [(f"{row.worst_db:.0f} dB", row) for row in (*front[:1], *front[1:][-1:])]
    bars = [*ends[:1], (_called(usual), usual), *ends[1:]]
    height = 0.8 / max(len(bars), 1)
    longest = max((max(row.stage_seconds.values()) for _, row in bars), default=1.0)
    for index, (name, row) in enumerate(bars):
        color = RED if row is usual else (LIGHT, BLUE)[index > 0]
        for place, stage in enumerate(STAGES):
            value = row.stage_seconds[stage]
            at = place + (index - 0.5 * (len(bars) - 1)) * height
            axis.barh(at, value, height * 0.9, color=color)
            axis.text(value + 0.01 * longest, at, f"{value:.2f} s  {name}", va="center", fontsize=8, color=GREY)
    axis.set_yticks(range(len(STAGES)), [STAGE_NAMES[stage] for stage in STAGES])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.3 * longest)
    axis.set_xlabel("seconds a frame, one core")
    _plain(axis, "Where do the seconds go?", "x", ("top", "right", "left"))
    axis.tick_params(axis="y", length=0)


def _plain(axis: Axes, title: str, grid: Literal["both", "x"], bare: Sequence[str]) -> None:
    """Title, a grid behind the marks, and no frame on the sides that are to be bare."""
    axis.set_title(title, loc="left", fontsize=13, weight="bold")
    axis.set_axisbelow(True)
    axis.grid(True, axis=grid, alpha=0.25)
    for side in bare:
        axis.spines[side].set_visible(False)


def write(rows: Sequence[Row], title: str, directory: Path) -> list[Path]:
    """``accuracy.parquet``, ``accuracy.csv`` and ``accuracy.png``; in the table of text ``stage_seconds`` is JSON.

    :raises OSError: the folder cannot be written
    """
    parquet, text, picture = (directory / f"accuracy.{suffix}" for suffix in ("parquet", "csv", "png"))
    with atomic(parquet) as partial:
        pq.write_table(pa.Table.from_pylist([asdict(row) for row in rows]), partial)
    with atomic(text) as partial, partial.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, [item.name for item in fields(Row)])
        writer.writeheader()
        writer.writerows({**asdict(row), "stage_seconds": json.dumps(row.stage_seconds)} for row in rows)
    save_figure(draw(rows, title), picture, 100)
    return [parquet, text, picture]
