"""Pictures of a measured row: cuts through it, and of a cube what stands around it, seen from above."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from shared.physics.errors import figure_text
from shared.pictures import SPAN_DB, draw_from_above, level_db, range_weighted_db
from trainer.evaluation.experiments.measured_input import MeasuredInput
from trainer.evaluation.report.figures import Look, colour_bar, legend_below, panels
from trainer.evaluation.store import Values

COLUMNS = 3
SHOWN_DEG = 15.0
"""On either side of the strongest line, in the cuts of a snapshot."""
FARTHEST = 2.0
"""Of the range of the row: as far as the picture reaches."""
DRAWN_BINS = (3, 3)
"""Range bins and angles over which every level is drawn: a line of one pixel could not be seen."""
PANEL_INCHES = 3.4
"""Width of a panel of the picture from above."""


def cut_figure(
    measured: MeasuredInput,
    title: str,
    spectra: Mapping[tuple[str, str], Values],
    reference: NDArray[np.float64],
    notes: Mapping[str, str],
) -> Figure:
    """Levels over azimuth of all methods, a panel for each array; left of the radar on the left.

    :param spectra: "u" and "spectrum" by (method, array)
    :param reference: angles to be drawn [deg]
    :param notes: beside an array's name
    """
    look = Look(spectra)
    columns = min(COLUMNS, len(look.arrays))
    where = "" if measured.radar is None else f", {measured.row * measured.radar.waveform.range_step_m:.2f} m"
    title = f"{title}: {figure_text(measured.path.name)}{where}"
    lines = -(-len(look.arrays) // columns)
    size = max(4.6 * columns, 7.0), 3.3 * lines + 1.1
    figure, axes = panels(lines, columns, size, title, len(look.arrays), sharex=True, sharey=True)
    for axis, array in zip(axes.ravel(), look.arrays, strict=False):
        for (method, of_array), values in spectra.items():
            if of_array == array:
                spectrum = values["spectrum"].astype(np.float64)
                degrees = np.rad2deg(np.arcsin(values["u"]))
                axis.plot(degrees, level_db(spectrum, float(spectrum.max())), color=look.colour(method), lw=1.1)
        for angle in reference:
            axis.axvline(angle, color="grey", lw=0.8, ls=":")
        name = figure_text(array)
        axis.set(title=f"{name}: {notes[array]}" if array in notes else name, ylim=(-SPAN_DB, 1.0))
        axis.set(xlabel="azimuth [deg]", xlim=_limits(measured, reference))
        axis.grid(alpha=0.25)
        axis.tick_params(labelbottom=True)
    for axis in axes[:, 0]:
        axis.set_ylabel("level [dB]")
    legend_below(figure, look.method_handles())
    return figure


def cartesian_figure(measured: MeasuredInput, images: Mapping[tuple[str, str], Values]) -> Figure:
    """Range-angle images of a cube's strongest Doppler peaks seen from above: y to the left, x ahead [m].

    Levels of amplitude times range, below each image's maximum.

    :param images: "image" [R, U] and "u" by (method, array)
    """
    assert measured.radar is not None
    waveform = measured.radar.waveform
    columns = min(COLUMNS, math.ceil(math.sqrt(len(images))))
    bins = min(max(int(FARTHEST * measured.row), 16), waveform.range_bins)
    # A panel is as high as the range and as wide as twice the largest y.
    widest = 2.0 * max(float(np.abs(values["u"]).max()) for values in images.values())
    lines = -(-len(images) // columns)
    size = PANEL_INCHES * columns + 1.4, (PANEL_INCHES / widest + 0.5) * lines + 0.8
    title = f"Seen from above: {figure_text(measured.path.name)}"
    figure, axes = panels(lines, columns, size, title, len(images), sharex=True, sharey=True)
    for axis, ((method, array), values) in zip(axes.ravel(), images.items(), strict=False):
        levels = maximum_filter(range_weighted_db(values["image"])[:bins], DRAWN_BINS)
        draw_from_above(axis, levels, waveform.range_step_m, values["u"])
        axis.set_title(figure_text(f"{method}, {array}"))
    for axis in axes[-1]:
        axis.set_xlabel("y, to the left [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("x, ahead [m]")
    colour_bar(figure, axes)
    return figure


def _limits(measured: MeasuredInput, reference: NDArray[np.float64]) -> tuple[float, float]:
    """Azimuths from left to right [deg]: all of a cube's, those around the reference of a snapshot, or all."""
    if measured.radar is None and len(reference):
        middle = float(np.mean(reference))
        return middle + SHOWN_DEG, middle - SHOWN_DEG
    return float(np.rad2deg(np.arcsin(measured.u[-1]))), float(np.rad2deg(np.arcsin(measured.u[0])))
