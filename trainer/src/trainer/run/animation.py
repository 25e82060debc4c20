"""The frames of ``trainer predict`` one after the other, as a GIF: the image, and the detections by velocity."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.dataset import METADATA_KEY
from shared.dataset.writing import write_bytes
from shared.physics.errors import InputError
from shared.pictures import LEVEL_LABEL, SPAN_DB, draw_levels, range_weighted_db

ANIMATION = "animation.gif"
FRAMES_PER_SECOND = 3
DOTS_PER_INCH = 80
"""A frame of two panels then has about 30 kB."""
LARGEST_DOT = 80.0
"""Of a detection as strong as the strongest of all frames [points^2]; one 40 dB weaker has none."""


def save_animation(images: Path, path: Path) -> int:
    """A GIF of ``images.parquet``, one picture a frame in the order of the file; returns the frames.

    On the left the image, amplitude x range, 0 dB at the maximum of all frames. On the right the detections, coloured
    by velocity, their area by level x range.

    :param images: as ``trainer predict --points`` writes it
    :raises InputError: a file without detections or frames
    """
    file = pq.ParquetFile(images)
    if "detections" not in file.schema_arrow.names:
        raise InputError(images, "no detections", "a file of trainer predict --points")
    if not file.metadata.num_rows:
        raise InputError(images, "no frames", "one at least")
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
    writer = PillowWriter(fps=FRAMES_PER_SECOND)
    # The writer tells the format by the file's name, and leaves half a file where it fails.
    with TemporaryDirectory() as folder:
        film = Path(folder) / ANIMATION
        with writer.saving(figure, str(film), DOTS_PER_INCH):
            for number, row in enumerate(_rows(file, ["frame_id", "image"])):
                levels = range_weighted_db(np.array(row["image"]).reshape(shape), reference=brightest)
                for artist in [*left.images, *right.collections]:
                    artist.remove()
                drawn = draw_levels(left, levels, step_m, u_start, u_step)
                range_m, u, velocity, weighted = frames[number]
                size = LARGEST_DOT * np.clip(1.0 + (weighted - strongest) / SPAN_DB, 0.0, 1.0) ** 2
                dots = right.scatter(u, range_m, s=size, c=velocity, **colours)
                if number == 0:
                    left.set(title=f"image, {LEVEL_LABEL}", xlabel="u = sin(azimuth)", ylabel="range [m]")
                    right.set(title="detections, range rate [m/s]", xlabel="u = sin(azimuth)")
                    figure.colorbar(drawn, ax=left)
                    figure.colorbar(dots, ax=right)
                figure.suptitle(f"frame {row['frame_id']}")
                writer.grab_frame()
        write_bytes(path, film.read_bytes())
    return len(frames)


def _rows(file: pq.ParquetFile, columns: list[str]) -> Iterator[dict[str, Any]]:
    """The rows one by one, so that no more than one image is held; an image is flat."""
    for batch in file.iter_batches(batch_size=1, columns=columns):
        yield {name: batch[name][0].values if name == "image" else batch[name][0].as_py() for name in columns}


def _detections(entries: list[dict[str, float]]) -> tuple[NDArray[np.float64], ...]:
    """(range [m], u, velocity [m/s], level x range [dB]), each [N]."""
    names = ("range", "u", "velocity", "amplitude_db")
    range_m, u, velocity, level_db = (np.array([entry[name] for entry in entries], dtype=float) for name in names)
    return range_m, u, velocity, level_db + 20.0 * np.log10(np.maximum(range_m, 1e-3))
