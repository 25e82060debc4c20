"""Range-angle images as pictures in dB: DaS, network and truth side by side, and the frames of ``trainer predict`` as a
GIF."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.dataset import METADATA_KEY
from shared.dataset.writing import write_bytes
from shared.physics.errors import figure_text
from shared.pictures import COLOUR_MAP, LEVEL_LABEL, SPAN_DB, draw_levels, film, range_weighted_db, save_figure
from shared.radar import Radar
from trainer.run.detections import Detections

ANIMATION = "animation.gif"
FRAMES_PER_SECOND = 3
DOTS_PER_INCH = 80
"""A frame of two panels then has about 30 kB."""
LARGEST_DOT = 80.0
"""Of a detection as strong as the strongest [points^2]; one 40 dB weaker has none."""
STANDING, MOVING = "white", "cyan"
"""Colours of points in a picture."""


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
    save_figure(figure, path, 100)


def save_picture(
    path: Path,
    images: Mapping[str, NDArray[np.floating]],
    radar: Radar,
    title: str,
    points: Detections | None = None,
) -> None:
    """A PNG of the images side by side with range and u axes, left of the radar on the left.

    :param points: shown beside them: their areas by level x range, and whether they move more likely than not
    """
    count = len(images) + (points is not None)
    figure = Figure(figsize=(4.0 * count, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
    for axis, (name, image) in zip(axes, images.items(), strict=False):
        levels = range_weighted_db(image)
        drawn = draw_levels(axis, levels, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)
        axis.set(title=figure_text(name), xlabel="u = sin(azimuth)")
    if points is not None:
        moves = points.moving > 0.5
        area = _areas(weighted := _weighted_db(points.amplitude_db, points.range_m), weighted.max(initial=-np.inf))
        for chosen, colour in ((~moves, STANDING), (moves, MOVING)):
            axes[-1].scatter(points.u[chosen], points.range_m[chosen], s=area[chosen], c=colour, linewidths=0.0)
        told = "" if np.isnan(points.moving).all() else f", {MOVING}: moving"
        axes[-1].set(title=f"points{told}", xlabel="u = sin(azimuth)", facecolor="black")
    axes[0].set_ylabel("range [m]")
    figure.colorbar(drawn, ax=axes, label=f"{LEVEL_LABEL}, 0 dB at the maximum")
    figure.suptitle(figure_text(title))
    save_figure(figure, path, 100)


def save_animation(images: Path, path: Path) -> int:
    """A GIF of ``images.parquet``, one picture a frame in the order of the file; returns the frames.

    On the left the image, amplitude x range, 0 dB at the maximum of all frames. On the right the detections, coloured
    by velocity, their area by level x range.

    :param images: as ``trainer predict --points`` writes it
    """
    file = pq.ParquetFile(images)
    about = json.loads(file.schema_arrow.metadata[METADATA_KEY])
    shape, axes = about["shapes"]["image"], about["axes"]
    step_m, u_start, u_step = axes["range_m"]["step"], axes["u"]["start"], axes["u"]["step"]
    frames = [_detections(row["detections"]) for row in _rows(file, ["detections"])]
    brightest = np.zeros(shape)
    for row in _rows(file, ["image"]):
        np.maximum(brightest, np.array(row["image"]).reshape(shape), out=brightest)
    strongest = max((weighted.max(initial=-np.inf) for *_, weighted in frames), default=0.0)
    fastest = max([float(np.abs(velocity).max(initial=0.0)) for _, _, velocity, _ in frames] + [1e-3])

    figure = Figure(figsize=(8.0, 4.6), layout="constrained", dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    colours = {"cmap": "coolwarm", "norm": Normalize(-fastest, fastest)}
    right.set_facecolor("black")

    def drawn() -> Iterator[int]:
        for number, row in enumerate(_rows(file, ["frame_id", "image"])):
            levels = range_weighted_db(np.array(row["image"]).reshape(shape), reference=brightest)
            for artist in [*left.images, *right.collections]:
                artist.remove()
            image = draw_levels(left, levels, step_m, u_start, u_step)
            range_m, u, velocity, weighted = frames[number]
            dots = right.scatter(u, range_m, s=_areas(weighted, strongest), c=velocity, **colours)
            if number == 0:
                left.set(title=f"image, {LEVEL_LABEL}", xlabel="u = sin(azimuth)", ylabel="range [m]")
                right.set(title="detections, range rate [m/s]", xlabel="u = sin(azimuth)")
                figure.colorbar(image, ax=left)
                figure.colorbar(dots, ax=right)
            figure.suptitle(f"frame {row['frame_id']}")
            yield number

    write_bytes(path, film(figure, drawn(), FRAMES_PER_SECOND))
    return len(frames)


def _rows(file: pq.ParquetFile, columns: list[str]) -> Iterator[dict[str, Any]]:
    """The rows one by one, so that no more than one image is held; an image is flat."""
    for batch in file.iter_batches(batch_size=1, columns=columns):
        yield {name: batch[name][0].values if name == "image" else batch[name][0].as_py() for name in columns}


def _detections(entries: list[dict[str, float]]) -> tuple[NDArray[np.float64], ...]:
    """(range [m], u, velocity [m/s], level x range [dB]), each [N]."""
    names = ("range", "u", "velocity", "amplitude_db")
    range_m, u, velocity, level_db = (np.array([entry[name] for entry in entries], dtype=float) for name in names)
    return range_m, u, velocity, _weighted_db(level_db, range_m)


def _weighted_db(level_db: NDArray[np.float64], range_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N] level x range [dB], as images are drawn."""
    return level_db + 20.0 * np.log10(np.maximum(range_m, 1e-3))


def _areas(weighted_db: NDArray[np.float64], strongest_db: float) -> NDArray[np.float64]:
    """[N] of the dots [points^2]."""
    return LARGEST_DOT * np.clip(1.0 + (weighted_db - strongest_db) / SPAN_DB, 0.0, 1.0) ** 2
