"""One look for all figures: a colour for each method, a line for each array, images in dB on one scale."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from shared.dataset.writing import write_bytes
from shared.physics.errors import figure_text
from shared.pictures import COLOUR_MAP, SPAN_DB, any_name, draw_levels
from shared.radar import Radar
from trainer.evaluation.report.tables import MetricRow

COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f5539", "#6a4c93", "#444444", "#b8b042",
    "#88ccaa", "#aa4466", "#cc2222",
)  # fmt: skip
"""Told apart by most colour-blind readers (Okabe and Ito, 2008), and some more."""
LINES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D")
TRUTH_COLOUR = "black"
PANEL_PIXELS = 260, 220
"""Height and width of a panel of :func:`trainer.evaluation.report.figures.image_panels`, 2.4 x 2 inches, in the PNG."""
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.grid": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.dpi": 110.0,
    # Matplotlib names the elements of SVG files at random without it.
    "svg.hashsalt": "trainer",
}


MARK_ABOVE_BINS = 3.0
"""From a target to the tip that points at it."""
SHEET_COLUMNS = 4


class Look:
    """Colours and lines of the methods and arrays of one figure.

    :param keys: (method, array) of each contender, in their order
    """

    def __init__(self, keys: Iterable[tuple[str, str]]) -> None:
        methods, arrays = zip(*keys, strict=True)
        self.methods, self.arrays = list(dict.fromkeys(methods)), list(dict.fromkeys(arrays))

    def colour(self, method: str) -> str:
        return COLOURS[self.methods.index(method) % len(COLOURS)]

    def line(self, array: str) -> str:
        return LINES[self.arrays.index(array) % len(LINES)]

    def marker(self, array: str) -> str:
        return MARKERS[self.arrays.index(array) % len(MARKERS)]

    def method_handles(self) -> list[Line2D]:
        return [Line2D([], [], color=self.colour(name), lw=2.5, label=figure_text(name)) for name in self.methods]

    def weight(self, method: str) -> float:
        """Line width; the first method, DaS, has a broad line that stays visible below others."""
        return 3.2 if self.methods.index(method) == 0 else 1.3

    def array_handles(self, lines: bool = True, markers: bool = True) -> list[Line2D]:
        handles = []
        for name in self.arrays:
            line, marker = self.line(name) if lines else "", self.marker(name) if markers else None
            handles.append(Line2D([], [], color="grey", ls=line, marker=marker, ms=4, label=figure_text(name)))
        return handles


def legend_below(figure: Figure, handles: Sequence[Line2D]) -> None:
    """Outside of all axes, so that it covers no data; in as many rows as its labels need."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    with any_name():
        for columns in range(len(handles), 0, -1):
            legend = figure.legend(handles=list(handles), loc="outside lower center", ncols=columns, frameon=False)
            if columns == 1 or legend.get_window_extent(canvas.get_renderer()).width <= figure.bbox.width:
                return
            legend.remove()


def label_ends(axis: Axes, ends: Sequence[tuple[float, str, str]]) -> None:
    """Names at the right of an axis, each at its line's last value or as near as the other names leave room.

    :param ends: (last value, name, colour) of each line
    """
    gap = 0.052  # from name to name at least, of the axis' height
    low, high = axis.get_ylim()
    ordered = sorted(ends)
    places: list[float] = []
    for value, _, _ in ordered:
        lowest = places[-1] + gap if places else 0.0
        places.append(max((value - low) / (high - low), lowest))
    # What is pushed out at the top pushes down in turn.
    for index in range(len(places) - 1, -1, -1):
        places[index] = min(places[index], places[index + 1] - gap if index + 1 < len(places) else 1.0)
    for place, (_, name, colour) in zip(places, ordered, strict=True):
        axis.text(
            1.015, place, figure_text(name), color=colour, fontsize=8, va="center", ha="left", transform=axis.transAxes
        )


def counted(count: int, noun: str) -> str:
    """ "1 frame", "2 frames"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def panels(
    lines: int, columns: int, size: tuple[float, float], title: str, shown: int | None = None, **arguments: Any
) -> tuple[Figure, NDArray[np.object_]]:
    """(figure, [lines, columns] axes) in the common style; independent of what else runs in the process.

    :param size: width and height of the figure [inches]
    :param shown: how many of the axes are shown; all by default
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(title, fontsize=10.0)
        axes = np.asarray(figure.subplots(lines, columns, squeeze=False, **arguments))
    for axis in axes.ravel()[axes.size if shown is None else shown :]:
        axis.set_visible(False)
    return figure, axes


def draw_bar(axis: Axes, place: float, row: MetricRow, width: float = 0.8, **style: Any) -> None:
    """A number as a bar, its interval as a line in it."""
    axis.bar(place, row.value, width, **style)
    if np.isfinite([row.low, row.high]).all():
        axis.plot([place, place], [row.low, row.high], color="black", lw=0.8)


def draw_image(axis: Axes, levels_db: NDArray[np.floating], radar: Radar, title: str, first_row: int = 0) -> None:
    """Levels [n, U] of the range bins from ``first_row`` on, the radar's left on the left."""
    draw_levels(
        axis, levels_db, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step, int(first_row), PANEL_PIXELS
    )
    axis.set_title(figure_text(title))


def colour_bar(figure: Figure, axes: NDArray[np.object_]) -> None:
    """The scale of all images of a figure, at the left of their axes."""
    scale = ScalarMappable(Normalize(-SPAN_DB, 0.0), COLOUR_MAP)
    figure.colorbar(scale, ax=axes.ravel().tolist(), label="level [dB]", location="left", aspect=40, pad=0.01)


def label_images(axes: NDArray[np.object_]) -> None:
    """Axis labels at the left and lower edge of a grid of images only."""
    for axis in axes[-1]:
        axis.set_xlabel("u = sin(azimuth)")
    for axis in axes[:, 0]:
        axis.set_ylabel("range [m]")
    for axis in axes[:, 1:].ravel():
        axis.set_yticklabels([])


def save_figure(figure: Figure, directory: Path, name: str) -> bytes:
    """Write ``name.png`` and ``name.svg``, whole or not at all; returns the PNG. Same figure, same bytes."""
    content = {}
    with matplotlib.rc_context(STYLE), any_name():
        # One layout serves both files: it takes longer than the drawing.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        for axes in figure.axes:  # the layout's last digits differ from run to run, and name the SVG's clips
            axes.set_position(np.round(axes.get_position(original=True).bounds, 9))
        for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, metadata=metadata)
            content[kind] = buffer.getvalue()
    for kind, text in content.items():
        write_bytes(directory / f"{name}.{kind}", text)
    return content["png"]


def image_panels(
    levels: Mapping[tuple[str, str], NDArray[np.floating]],
    truth: NDArray[np.floating],
    radar: Radar,
    first_row: int,
    title: str,
    marks: Sequence[tuple[float, float]],
    reach: float,
    notes: Mapping[tuple[str, str], str],
) -> Figure:
    """Images of targets on one dB scale, at the right a cut through the range bin of the first one.

    :param levels: by (method, array) [n, U] range bins from ``first_row`` on [dB], at most 0
    :param truth: the same of the virtual sensor's image
    :param marks: (range [m], u) of the targets, pointed at from above
    :param reach: u shown beyond the outermost targets
    :param notes: numbers written into the panels, by (method, array)
    """
    look = Look(levels)
    names, targets = [*look.methods, "truth"], [u for _, u in marks]
    ratios = [1.0] * len(names) + [1.8]
    size = 2.0 * sum(ratios) + 0.8, 2.4 * len(look.arrays) + 1.1
    figure, axes = panels(len(look.arrays), len(ratios), size, title, width_ratios=ratios)
    above = [r + MARK_ABOVE_BINS * radar.waveform.range_step_m for r, _ in marks]
    limits = max(targets) + reach, min(targets) - reach  # u falls from left to right
    cut_row = round(marks[0][0] / radar.waveform.range_step_m) - first_row
    for line, array in enumerate(look.arrays):
        for axis, name in zip(axes[line], names, strict=False):
            image = truth if name == "truth" else levels.get((name, array))
            if image is None:
                missing = f"no {figure_text(name)}\nfor {figure_text(array)}"
                axis.text(0.5, 0.5, missing, ha="center", va="center", transform=axis.transAxes)
                axis.set_axis_off()
                continue
            draw_image(axis, image, radar, "truth" if name == "truth" else f"{name}, {array}", first_row)
            if note := notes.get((name, array)):
                box = {"facecolor": "black", "edgecolor": "none", "alpha": 0.6, "pad": 1.0}
                place = {"ha": "center", "va": "bottom", "transform": axis.transAxes}
                axis.text(0.5, 0.02, note, color="white", fontsize=7, bbox=box, **place)
            axis.plot(targets, above, "v", color="cyan", ms=4, mew=0.0)
            axis.set_xlim(limits)
        cut = axes[line, -1]
        cut.plot(radar.grid.u, truth[cut_row], color=TRUTH_COLOUR, lw=0.8)
        for (method, of_array), image in levels.items():
            if of_array == array:
                cut.plot(radar.grid.u, image[cut_row], color=look.colour(method), lw=1.2)
        for u in targets:
            cut.axvline(u, color="grey", lw=0.6, ls=":")
        cut.set(xlim=limits, ylim=(-SPAN_DB, 2.0), title=f"cut, {figure_text(array)}", ylabel="level [dB]")
        cut.grid(alpha=0.25)
        cut.yaxis.set_label_position("right")
        cut.yaxis.tick_right()
    label_images(axes[:, :-1])
    colour_bar(figure, axes[:, :-1])
    axes[-1, -1].set_xlabel("u = sin(azimuth)")
    reference = Line2D([], [], color=TRUTH_COLOUR, lw=0.8, label="truth")
    legend_below(figure, [*look.method_handles(), reference])
    return figure


def image_sheet(
    levels: Mapping[str, NDArray[np.floating]], truth: NDArray[np.floating], radar: Radar, title: str
) -> Figure:
    """Images of all methods for one array, :data:`SHEET_COLUMNS` a line, the truth last: legible at a page's width.

    :param levels: [R, U] by method [dB], at most 0
    :param truth: the same of the virtual sensor's image
    """
    images = [*levels.items(), ("truth", truth)]
    lines = -(-len(images) // SHEET_COLUMNS)
    size = 2.2 * SHEET_COLUMNS + 0.8, 2.3 * lines + 0.6
    figure, axes = panels(lines, SHEET_COLUMNS, size, title, len(images))
    for axis, (name, image) in zip(axes.ravel(), images, strict=False):
        draw_image(axis, image, radar, name)
    label_images(axes)
    colour_bar(figure, axes)
    return figure
