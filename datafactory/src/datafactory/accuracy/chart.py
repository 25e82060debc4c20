"""The price list as a picture for someone who sees it for the first time: one panel a question, labels at the marks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, zip_longest
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter

from datafactory.accuracy.looking import STAGES
from datafactory.accuracy.study import DEFAULTS, FRONT, Row
from shared.dataset.writing import atomic

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


def _front_panel(axis: Axes, front: Sequence[Row], usual: Row) -> None:
    """Seconds over error."""
    axis.plot([row.worst_db for row in front], [row.seconds for row in front], "o-", color=BLUE, lw=2.0, ms=5)
    _rays_beside(axis, front)
    axis.plot([usual.worst_db], [usual.seconds], "*", color=RED, ms=16, zorder=4)
    axis.annotate(
        "the default", (usual.worst_db, usual.seconds), xytext=(-10, 6), textcoords="offset points", color=RED,
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
    bars = [*ends[:1], ("the default", usual), *ends[1:]]
    height = 0.8 / max(len(bars), 1)
    longest = max((max(row.stage_seconds.values()) for _, row in bars), default=1.0)
    for index, (name, row) in enumerate(bars):
        color = RED if name == "the default" else (LIGHT, BLUE)[index > 0]
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


def write_picture(rows: Sequence[Row], title: str, directory: Path) -> Path:
    """``accuracy.png``.

    :raises OSError: the folder cannot be written
    """
    path = directory / "accuracy.png"
    with atomic(path) as partial:
        draw(rows, title).savefig(partial, format="png", dpi=100, metadata={"Software": None})
    return path
