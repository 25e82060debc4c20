"""The price list as a picture for someone who sees it for the first time: one panel a question, labels at the marks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from datafactory.accuracy.clock import STAGES
from datafactory.accuracy.errors import FLOOR_DB
from datafactory.accuracy.front import EVERYTHING, SAME_PATHS
from datafactory.accuracy.row import DEFAULTS, Row
from datafactory.effects.catalogue import NAMES
from shared.dataset.writing import atomic

BLUE, ORANGE, RED, GREY, LIGHT = "#1f5fa8", "#c26a00", "#c4282d", "#555555", "#c9d6e6"
STAGE_NAMES = {
    "trace": "trace the rays", "delays and spread": "input cube", "range-Doppler": "range-Doppler spectra",
    "truth": "truth", "image": "truth's image", "write": "write the file",
}  # fmt: skip
SHORTCUTS = {
    ("delays", "linear"): "delays linear in time",
    ("truth_wave", "plane"): "plane waves in the truth",
    ("width", "float32 geometry"): "coordinates in float32",
    ("width", "complex128"): "sums in complex128",
    ("finite_mirrors", "off"): "mirrors without end",
    ("surface_phase", "off"): "surfaces without roughness",
    ("lattice", "all around"): "rays all around",
    ("video_phase", "on"): "residual video phase added",
}
"""Rows that are shortcuts, or the contrary, by knob and setting, with their words."""
LEAST_S = 0.005
"""Shorter times have no mark."""
RAYS_AT = {"left": (8, -9), "right": (-8, 5)}
"""Where the label of a point has its left or its right end, from the point on [points]."""
CLOSE_DB, CLOSE_RATIO = 10.0, 1.25
"""Labels on one side of points that lie no further apart would stand one over the other."""
WIDE = 8.0
"""Dearest over cheapest of a front from which on its seconds stand on a logarithmic axis."""


def front_error_db(row: Row) -> float:
    """The worst of a front's errors."""
    return max(error for error in (row.cube_error_db, row.image_error_db, row.power_error_db) if error is not None)


def default_error_db(rows: Sequence[Row]) -> tuple[float | None, float | None]:
    """The default's worst error, of everything and on the same paths; None where it was not measured."""
    found = {row.kind: row for row in rows if row.knob == DEFAULTS}
    if "signal" not in found:
        return None, None
    signal = max(found["signal"].cube_error_db, found["signal"].image_error_db)
    if "power" not in found:
        return None, signal
    return max(signal, found["power"].image_error_db), signal


def default_row(rows: Sequence[Row]) -> Row | None:
    """The default as it is timed: from its rays on, as a front's points are, where that was measured."""
    found = {row.kind: row for row in rows if row.knob == DEFAULTS}
    return found.get("power", found.get("signal"))


def draw(rows: Sequence[Row], title: str) -> Figure:
    """What accuracy costs, where the seconds go, what effects cost, and what other ways would."""
    figure = Figure(figsize=(15.0, 11.0), layout="constrained")
    axes = figure.subplots(2, 2, height_ratios=(1.15, 1.0))
    _front_panel(axes[0, 0], rows)
    _stage_panel(axes[0, 1], rows)
    of_effects = [row for row in rows if row.knob in NAMES]
    others = [row for row in rows if (row.knob, row.setting) in SHORTCUTS]
    _difference_panel(
        axes[1, 0], "What does each effect cost?", "what it changes [dB of the peak]", of_effects,
        [row.knob.replace("_", " ") for row in of_effects],
    )  # fmt: skip
    _difference_panel(
        axes[1, 1], "What would other ways cost?", "the error", others,
        [SHORTCUTS[row.knob, row.setting] for row in others],
    )  # fmt: skip
    figure.suptitle(title, fontsize=11, color=GREY)
    return figure


def _front_panel(axis: Axes, rows: Sequence[Row]) -> None:
    """Seconds over error."""
    errors = default_error_db(rows)
    for name, color, words, default_db, away, align in (
        (EVERYTHING, BLUE, "everything, rays too", errors[0], (-10, 4), "bottom"),
        (SAME_PATHS, ORANGE, "the same rays:\ncube and truth alone", errors[1], (0, -24), "top"),
    ):
        points = [(front_error_db(row), row.seconds, row) for row in rows if row.knob == name]
        if not points:
            continue
        axis.plot([point[0] for point in points], [point[1] for point in points], "o-", color=color, lw=2.0, ms=5)
        last = points[-1]
        axis.annotate(
            words, last[:2], xytext=away, textcoords="offset points", color=color, fontsize=10, weight="bold",
            ha="right", va=align,
        )  # fmt: skip
        if name == EVERYTHING:
            _rays_beside(axis, points, color)
        usual = default_row(rows)
        if usual is not None and default_db is not None:
            axis.plot([default_db], [usual.seconds], "*", color=RED, ms=16, zorder=4)
            axis.annotate(
                "the default", (default_db, usual.seconds), xytext=(0, 12), textcoords="offset points", color=RED,
                fontsize=10, weight="bold", ha="center",
            )  # fmt: skip
    axis.invert_xaxis()
    axis.margins(x=0.25, y=0.15)
    prices = [row.seconds for row in rows if row.knob in (EVERYTHING, SAME_PATHS)]
    if prices and max(prices) > WIDE * min(prices):
        axis.set_yscale("log")
        axis.set_ylim(min(prices) / 2.0, max(prices) * 2.0)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    else:
        axis.set_ylim(bottom=0.0)
    axis.set_xlabel("error [dB], the worst of input cube, truth image and power in a cell: better to the right")
    axis.set_ylabel("seconds a frame, one core")
    _titled(axis, "What does accuracy cost?")
    axis.grid(True, alpha=0.25)


def _rays_beside(axis: Axes, points: Sequence[tuple[float, float, Row]], color: str) -> None:
    """The number of rays at each point where it changes: to the right, of two points close together the first's to the
    left; none where neither side has room."""
    changes = [next(same) for _, same in groupby(points, lambda point: _rays(point[2]))]
    taken: dict[str, tuple[float, float]] = {}
    for place, (level, seconds, row) in enumerate(changes):
        crowded = place + 1 < len(changes) and _close(changes[place + 1][:2], (level, seconds))
        for align in ("right", "left") if crowded else ("left", "right"):
            if align not in taken or not _close((level, seconds), taken[align]):
                axis.annotate(
                    f"{_rays(row):,} rays".replace(",", " "), (level, seconds), xytext=RAYS_AT[align], fontsize=8,
                    textcoords="offset points", color=color, ha=align,
                )  # fmt: skip
                taken[align] = level, seconds
                break


def _rays(row: Row) -> int:
    return int(row.setting.split(": ")[1].split(" rays")[0])


def _close(point: tuple[float, float], before: tuple[float, float]) -> bool:
    return abs(point[0] - before[0]) <= CLOSE_DB and point[1] <= CLOSE_RATIO * before[1]


def _stage_panel(axis: Axes, rows: Sequence[Row]) -> None:
    """Seconds of every stage: the default, and the ends of the front."""
    front = [row for row in rows if row.knob == EVERYTHING]
    usual = default_row(rows)
    bars = [(f"{front_error_db(front[0]):.0f} dB", front[0])] if front else []
    if usual is not None:
        bars.append(("the default", usual))
    if front:
        bars.append((f"{front_error_db(front[-1]):.0f} dB", front[-1]))
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
    _titled(axis, "Where do the seconds go?")
    _plain(axis)


def _difference_panel(axis: Axes, title: str, beside: str, some: Sequence[Row], names: Sequence[str]) -> None:
    """Seconds that a frame has more or fewer, with the error beside them, or what the plan knows of an effect.

    :param beside: what the figures beside the bars are
    """
    entries = []
    for row, name in zip(some, names, strict=True):
        if row.seconds_beside is None:
            continue
        error = max(row.cube_error_db, row.image_error_db) if row.plan_db is None else row.plan_db
        entries.append(
            (row.seconds - row.seconds_beside, name, "no error in power" if error <= FLOOR_DB else f"{round(error)} dB")
        )
    entries.sort()
    reach = max((abs(seconds) for seconds, _, _ in entries), default=1.0) or 1.0
    for place, (seconds, _, change) in enumerate(entries):
        if abs(seconds) >= LEAST_S:
            axis.barh(place, seconds, 0.6, color=BLUE if seconds < 0.0 else ORANGE)
        at = max(seconds, 0.0) + 0.03 * reach
        axis.text(at, place, f"{seconds:+.2f} s, {change}", va="center", fontsize=9, color=GREY)
    axis.set_yticks(range(len(entries)), [name for _, name, _ in entries])
    axis.set_xlim(-1.15 * reach, 1.9 * reach)
    axis.axvline(0.0, color=GREY, lw=0.8)
    axis.set_xlabel(f"seconds a frame, less (left) or more (right); beside them {beside}")
    _titled(axis, title)
    _plain(axis)


def _titled(axis: Axes, title: str) -> None:
    axis.set_title(title, loc="left", fontsize=13, weight="bold")


def _plain(axis: Axes) -> None:
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.tick_params(axis="y", length=0)
    axis.grid(True, axis="x", alpha=0.25)


def write_picture(rows: Sequence[Row], title: str, directory: Path) -> Path:
    """``accuracy.png``.

    :raises OSError: the folder cannot be written
    """
    path = directory / "accuracy.png"
    with atomic(path) as partial:
        draw(rows, title).savefig(partial, format="png", dpi=100, metadata={"Software": None})
    return path
