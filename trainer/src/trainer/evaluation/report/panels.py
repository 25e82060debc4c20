"""Images of all contenders beside the truth: a line of panels for each array, a column for each method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from shared.physics.errors import figure_text
from shared.pictures import SPAN_DB
from shared.radar import Radar
from trainer.evaluation.report.style import (
    TRUTH_COLOUR,
    Look,
    colour_bar,
    draw_image,
    label_images,
    legend_below,
    new_figure,
    subplots,
)

MARK_ABOVE_BINS = 3.0
"""From a target to the tip that points at it."""

SHEET_COLUMNS = 4

Levels = Mapping[tuple[str, str], NDArray[np.floating]]
"""Levels [dB] of images by (method, array)."""


def image_panels(
    levels: Levels,
    truth: NDArray[np.floating] | None,
    radar: Radar,
    first_row: int,
    title: str,
    marks: Sequence[tuple[float, float]] = (),
    reach: float | None = None,
    notes: Mapping[tuple[str, str], str] | None = None,
) -> Figure:
    """Images on one dB scale; where there are targets, a cut through the range bin of the first at the right.

    :param levels: [n, U] range bins from ``first_row`` on [dB], at most 0
    :param truth: the same of the virtual sensor's image
    :param marks: (range [m], u) of the targets, pointed at from above
    :param reach: u shown beyond the outermost targets; all by default
    :param notes: numbers written into the panels, by (method, array)
    """
    look = Look([method for method, _ in levels], [array for _, array in levels])
    names = [*look.methods, *(["truth"] if truth is not None else [])]
    with_cut = bool(marks)
    ratios = [1.0] * len(names) + [1.8] * with_cut
    figure = new_figure(2.0 * sum(ratios) + 0.8, 2.4 * len(look.arrays) + 1.1, title)
    axes = subplots(figure, len(look.arrays), len(ratios), width_ratios=ratios)
    for line, array in enumerate(look.arrays):
        for axis, name in zip(axes[line], names, strict=False):
            image = truth if name == "truth" else levels.get((name, array))
            if image is None:
                missing = f"no {figure_text(name)}\nfor {figure_text(array)}"
                axis.text(0.5, 0.5, missing, ha="center", va="center", transform=axis.transAxes)
                axis.set_axis_off()
                continue
            draw_image(axis, image, radar, "truth" if name == "truth" else f"{name}, {array}", first_row)
            note = (notes or {}).get((name, array))
            if note:
                box = {"facecolor": "black", "edgecolor": "none", "alpha": 0.6, "pad": 1.0}
                place = {"ha": "center", "va": "bottom", "transform": axis.transAxes}
                axis.text(0.5, 0.02, note, color="white", fontsize=7, bbox=box, **place)
            above = [r + MARK_ABOVE_BINS * radar.waveform.range_step_m for r, _ in marks]
            axis.plot([u for _, u in marks], above, "v", color="cyan", ms=4, mew=0.0)
            axis.set_xlim(_limits(radar, [u for _, u in marks], reach))
        if with_cut:
            cut_row = round(marks[0][0] / radar.waveform.range_step_m)
            _draw_cut(axes[line, -1], look, array, levels, truth, radar, cut_row - first_row)
            axes[line, -1].set_xlim(_limits(radar, [u for _, u in marks], reach))
            for _, u in marks:
                axes[line, -1].axvline(u, color="grey", lw=0.6, ls=":")
    image_axes = axes[:, : len(names)]
    label_images(image_axes)
    colour_bar(figure, image_axes)
    if with_cut:
        axes[-1, -1].set_xlabel("u = sin(azimuth)")
        reference = [Line2D([], [], color=TRUTH_COLOUR, lw=0.8, label="truth")] if truth is not None else []
        legend_below(figure, [*look.method_handles(), *reference])
    return figure


def image_sheet(
    levels: Mapping[str, NDArray[np.floating]], truth: NDArray[np.floating], radar: Radar, title: str
) -> Figure:
    """Images of all methods for one array, :data:`SHEET_COLUMNS` a line, the truth last: legible at a page's width.

    :param levels: [R, U] by method [dB], at most 0
    :param truth: the same of the virtual sensor's image
    """
    panels = [*levels.items(), ("truth", truth)]
    lines = -(-len(panels) // SHEET_COLUMNS)
    figure = new_figure(2.2 * SHEET_COLUMNS + 0.8, 2.3 * lines + 0.6, title)
    axes = subplots(figure, lines, SHEET_COLUMNS)
    for axis, (name, image) in zip(axes.ravel(), panels, strict=False):
        draw_image(axis, image, radar, name)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    label_images(axes)
    colour_bar(figure, axes)
    return figure


def _draw_cut(
    axis: Axes, look: Look, array: str, levels: Levels, truth: NDArray[np.floating] | None, radar: Radar, row: int
) -> None:
    if truth is not None:
        axis.plot(radar.grid.u, truth[row], color=TRUTH_COLOUR, lw=0.8)
    for (method, of_array), image in levels.items():
        if of_array == array:
            axis.plot(radar.grid.u, image[row], color=look.colour(method), lw=1.2)
    axis.set(ylim=(-SPAN_DB, 2.0), title=f"cut, {figure_text(array)}", ylabel="level [dB]")
    axis.grid(alpha=0.25)
    axis.yaxis.set_label_position("right")
    axis.yaxis.tick_right()


def _limits(radar: Radar, targets: Sequence[float], reach: float | None) -> tuple[float, float]:
    """u falls from left to right, as in the images."""
    if reach is None or not targets:
        return radar.grid.u_stop, radar.grid.u_start
    return max(targets) + reach, min(targets) - reach
