"""Range-angle images as pictures: DaS, network and truth side by side, in dB."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.radar import Radar
from shared.units import amplitude_to_db

SPAN_DB = 40.0
"""Levels shown below the maximum [dB]."""


def level_db(image: NDArray[np.floating]) -> NDArray[np.float64]:
    """[R, U] level below the picture's maximum, weighted by range, at least -:data:`SPAN_DB` [dB].

    An echo's amplitude falls with R^2 and a picture has 40 dB: without the weight only the nearest metres would show.
    """
    weighted = np.asarray(image, dtype=np.float64) * np.arange(len(image))[:, None]
    peak = weighted.max()
    if peak <= 0:
        return np.full(image.shape, -SPAN_DB)
    return np.asarray(np.maximum(amplitude_to_db(weighted / peak), -SPAN_DB))


def panel(images: Mapping[str, NDArray[np.floating]]) -> NDArray[np.uint8]:
    """[R, n U, 3] colours of the images in one row, far range at the top, without axes."""
    columns = [colormaps["magma"](1.0 + level_db(image)[::-1] / SPAN_DB)[..., :3] for image in images.values()]
    return np.asarray(255.0 * np.concatenate(columns, axis=1), dtype=np.uint8)


def save_picture(path: Path, images: Mapping[str, NDArray[np.floating]], radar: Radar, title: str) -> None:
    """A PNG of the images side by side with range and u axes, left of the radar on the left."""
    figure = Figure(figsize=(4.0 * len(images), 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(images), sharey=True, squeeze=False)[0]
    grid = radar.grid
    far = radar.waveform.range_bins * radar.waveform.range_step_m
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        # Column 0 is u_start, on the right: u rises to the left of the radar.
        drawn = axis.imshow(
            level_db(image)[:, ::-1], origin="lower", aspect="auto", vmin=-SPAN_DB, vmax=0.0, cmap="magma",
            extent=(grid.u_stop, grid.u_start, 0.0, far),
        )  # fmt: skip
        axis.set(title=name, xlabel="u = sin(azimuth)")
    axes[0].set_ylabel("range [m]")
    figure.colorbar(drawn, ax=axes, label="amplitude x range [dB below maximum]")
    figure.suptitle(title)
    figure.savefig(path, dpi=100, metadata={"Software": None})
