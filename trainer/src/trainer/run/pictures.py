"""Range-angle images as pictures: DaS, network and truth side by side, in dB."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.dataset.writing import atomic
from shared.physics.errors import figure_text
from shared.pictures import COLOUR_MAP, LEVEL_LABEL, SPAN_DB, draw_levels, range_weighted_db
from shared.radar import Radar


def panel(images: Mapping[str, NDArray[np.floating]]) -> NDArray[np.uint8]:
    """[R, n U, 3] colours of the images in one row, far range at the top, without axes."""
    columns = [
        colormaps[COLOUR_MAP](1.0 + range_weighted_db(image)[::-1] / SPAN_DB)[..., :3] for image in images.values()
    ]
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
            levels = range_weighted_db(image, reference=reference)
            drawn = draw_levels(axis, levels, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)
            if axis in axes[0]:
                axis.set_title(figure_text(name))
            if axis in axes[-1]:
                axis.set_xlabel("u = sin(azimuth)")
        line[0].set_ylabel(f"{figure_text(title)}\nrange [m]")
    figure.colorbar(drawn, ax=axes, label=f"{LEVEL_LABEL}, 0 dB at the truth's maximum", aspect=40)
    _save(figure, path)


def save_picture(path: Path, images: Mapping[str, NDArray[np.floating]], radar: Radar, title: str) -> None:
    """A PNG of the images side by side with range and u axes, left of the radar on the left."""
    figure = Figure(figsize=(4.0 * len(images), 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(images), sharey=True, squeeze=False)[0]
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        levels = range_weighted_db(image)
        drawn = draw_levels(axis, levels, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)
        axis.set(title=figure_text(name), xlabel="u = sin(azimuth)")
    axes[0].set_ylabel("range [m]")
    figure.colorbar(drawn, ax=axes, label=f"{LEVEL_LABEL}, 0 dB at the maximum")
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
