"""Range-angle images as pictures: DaS, network and truth side by side, in dB."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from shared.dataset.writing import atomic
from shared.physics.errors import figure_text
from shared.physics.units import amplitude_to_db
from shared.radar import Radar

SPAN_DB = 40.0
"""Levels shown below the maximum [dB]."""
PANEL_PIXELS = 320, 300
"""Height and width of a panel in the pictures."""
U_INTERVALS = 4
"""Between ticks of u, at most: their labels stay apart in the narrowest panel."""


def range_weighted_db(
    image: NDArray[np.floating], span_db: float = SPAN_DB, reference: NDArray[np.floating] | None = None
) -> NDArray[np.float64]:
    """[R, U] level below the maximum of the image, or of a reference, weighted by range, from -``span_db`` on [dB].

    An echo's amplitude falls with R^2 and a picture has 40 dB: without the weight only the nearest metres would show.
    """
    distance = np.arange(len(image))[:, None]
    weighted = np.asarray(image, dtype=np.float64) * distance
    peak = (weighted if reference is None else np.asarray(reference, dtype=np.float64) * distance).max()
    if peak <= 0:
        return np.full(image.shape, -span_db)
    return np.asarray(np.maximum(amplitude_to_db(weighted / peak), -span_db))


def hold_peaks(levels_db: NDArray[np.floating], pixels: tuple[int, int]) -> tuple[NDArray[np.floating], int, int]:
    """(the highest level of every block of bins, the rows and columns of a block), at most ``pixels`` blocks.

    A panel has fewer pixels than an image has bins, and a target is one bin: drawn by the nearest, two of three vanish.
    The last blocks may hold fewer bins.
    """
    rows, columns = (-(-bins // most) for bins, most in zip(levels_db.shape, pixels, strict=True))
    held = np.maximum.reduceat(levels_db, np.arange(0, levels_db.shape[0], rows), axis=0)
    return np.maximum.reduceat(held, np.arange(0, levels_db.shape[1], columns), axis=1), rows, columns


def _draw(axis: Axes, levels_db: NDArray[np.floating], radar: Radar) -> AxesImage:
    """Levels [R, U] with the radar's left on the left."""
    return draw_levels(axis, levels_db, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)


def draw_levels(
    axis: Axes, levels_db: NDArray[np.floating], range_step_m: float, u_start: float, u_step: float
) -> AxesImage:
    """Levels [R, U] over range bins from 0 [m] and angle bins from ``u_start``, u rising to the left."""
    held, rows, columns = hold_peaks(levels_db, PANEL_PIXELS)
    left = u_start + columns * held.shape[1] * u_step
    far = rows * held.shape[0] * range_step_m
    drawn = axis.imshow(
        held[:, ::-1], origin="lower", aspect="auto", vmin=-SPAN_DB, vmax=0.0, cmap="magma",
        extent=(left, u_start, 0.0, far), interpolation="nearest",
    )  # fmt: skip
    bins = levels_db.shape
    axis.set(xlim=(u_start + bins[1] * u_step, u_start), ylim=(0.0, bins[0] * range_step_m))
    axis.xaxis.set_major_locator(MaxNLocator(U_INTERVALS))
    return drawn


def panel(images: Mapping[str, NDArray[np.floating]]) -> NDArray[np.uint8]:
    """[R, n U, 3] colours of the images in one row, far range at the top, without axes."""
    columns = [colormaps["magma"](1.0 + range_weighted_db(image)[::-1] / SPAN_DB)[..., :3] for image in images.values()]
    return np.asarray(255.0 * np.concatenate(columns, axis=1), dtype=np.uint8)


def save_comparison(path: Path, frames: Mapping[str, Mapping[str, NDArray[np.floating]]], radar: Radar) -> None:
    """A PNG with a row for each frame and a column for each of its images, the last of which sets the row's 0 dB."""
    count = len(next(iter(frames.values())))
    figure = Figure(figsize=(3.6 * count, 3.6 * len(frames) + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(frames), count, sharex=True, sharey=True, squeeze=False)
    for line, (title, images) in zip(axes, frames.items(), strict=True):
        reference = list(images.values())[-1]
        for axis, (name, image) in zip(line, images.items(), strict=True):
            drawn = _draw(axis, range_weighted_db(image, reference=reference), radar)
            if axis in axes[0]:
                axis.set_title(figure_text(name))
            if axis in axes[-1]:
                axis.set_xlabel("u = sin(azimuth)")
        line[0].set_ylabel(f"{figure_text(title)}\nrange [m]")
    figure.colorbar(drawn, ax=axes, label="amplitude x range [dB of the truth's maximum]", aspect=40)
    _save(figure, path)


def save_picture(path: Path, images: Mapping[str, NDArray[np.floating]], radar: Radar, title: str) -> None:
    """A PNG of the images side by side with range and u axes, left of the radar on the left."""
    figure = Figure(figsize=(4.0 * len(images), 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(images), sharey=True, squeeze=False)[0]
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        drawn = _draw(axis, range_weighted_db(image), radar)
        axis.set(title=figure_text(name), xlabel="u = sin(azimuth)")
    axes[0].set_ylabel("range [m]")
    figure.colorbar(drawn, ax=axes, label="amplitude x range [dB below maximum]")
    figure.suptitle(figure_text(title))
    _save(figure, path)


@contextmanager
def any_name() -> Iterator[None]:
    """Draw names of any script without a word: a box stands for what the font does not have."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def _save(figure: Figure, path: Path) -> None:
    with atomic(path) as partial, any_name():
        # The file does not name the version of matplotlib, so that the bytes do not depend on it.
        figure.savefig(partial, format="png", dpi=100, metadata={"Software": None})
