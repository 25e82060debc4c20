"""A sequence of frames as an animation: what the array measures, the truth, and what a camera at the sensor sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory.view.camera import draw_camera
from datafactory.view.cameras import Cameras, seen
from shared.dataset import Frame
from shared.dataset.folder import Dataset
from shared.dataset.locations import Location
from shared.dataset.reading import radar_of, read_frame
from shared.dataset.writing import write_bytes
from shared.physics.errors import figure_text
from shared.pictures import LEVEL_LABEL, any_name, draw_levels, range_weighted_db
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum

MOST_PICTURES = 60
"""Of one animation; a longer sequence is shown in strides."""
LARGEST_BYTES = 3_000_000
"""Of the file: where it is larger, every second picture is left out, until it is not."""
DOTS_PER_INCH = 72
FASTEST, SLOWEST = 20, 1
"""Pictures a second; in between as fast as it was."""
TITLES = ("measured, delay-and-sum", "truth")


@dataclass(frozen=True)
class SequenceRows:
    """Where the frames of a sequence stand.

    :param number: of the sequence
    :param split: that it belongs to
    :param rows: shard and row of its frames, in the order of time
    """

    number: int
    split: str
    rows: tuple[tuple[Location, int], ...]


def sequences_of(dataset: Dataset) -> list[SequenceRows]:
    """Every sequence of a dataset, by number."""
    found: dict[int, tuple[str, list[tuple[Location, int]]]] = {}
    for split in dataset.splits:
        for place, frame in zip(dataset.rows(split), dataset.frames(split, columns=()), strict=True):
            if frame.sequence >= 0:
                found.setdefault(frame.sequence, (split, []))[1].append(place)
    return [SequenceRows(number, split, tuple(rows)) for number, (split, rows) in sorted(found.items())]


def write_animations(dataset: Dataset, count: int, folder: Path, cameras: Cameras | None = None) -> list[Path]:
    """Draw ``count`` sequences, the first of each split first, as ``sequence-NNNN.gif`` of less than 3 MB each.

    :param cameras: make the camera pictures that were not written with the frames
    :raises InputError: a shard that is damaged, a scene that is not what it was
    """
    every = sequences_of(dataset)
    firsts = {item.split: item for item in reversed(every)}
    chosen = [*(item for item in every if item in firsts.values()), *(i for i in every if i not in firsts.values())]
    radar = radar_of(dataset.description(), dataset.path)
    paths = []
    for sequence in chosen[:count]:
        path = folder / f"sequence-{sequence.number:04d}.gif"
        stride = -(-len(sequence.rows) // MOST_PICTURES)
        while True:
            film = _film(dataset, sequence, sequence.rows[::stride], radar, cameras)
            if len(film) < LARGEST_BYTES or stride >= len(sequence.rows):
                break
            stride *= 2
        write_bytes(path, film)
        paths.append(path)
    return paths


def _film(
    dataset: Dataset,
    sequence: SequenceRows,
    rows: Sequence[tuple[Location, int]],
    radar: Radar,
    cameras: Cameras | None,
) -> bytes:
    """The GIF of some frames; 0 dB is the maximum of the truth of all of them."""
    frames = [read_frame(shard, row, columns=("range_channel", "image")) for shard, row in rows]
    brightest = np.maximum.reduce([_truth(frame) for frame in frames])
    first = seen(dataset, frames[0], cameras)
    figure = Figure(figsize=(7.0 if first is None else 11.5, 4.6), layout="constrained", dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2 if first is None else 3, width_ratios=[1.0, 1.0] if first is None else [1.0, 1.0, 1.5])
    # The writer tells the format by the file's name, and leaves half a file where it fails.
    with TemporaryDirectory() as scratch, any_name():
        film = Path(scratch) / "film.gif"
        writer = PillowWriter(fps=_pictures_a_second(frames))
        with writer.saving(figure, str(film), DOTS_PER_INCH):
            for number, frame in enumerate(frames):
                images = np.abs(delay_and_sum(frame.range_channel[0], radar)), _truth(frame)
                for axis, image, title in zip(axes, images, TITLES, strict=False):
                    for artist in list(axis.images):
                        artist.remove()
                    levels = range_weighted_db(image, reference=brightest)
                    drawn = draw_levels(axis, levels, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)
                    axis.set(title=title, xlabel="u = sin(azimuth)")
                    axis.label_outer()
                if number == 0:
                    axes[0].set_ylabel("range [m]")
                    figure.colorbar(drawn, ax=axes[:2], label=f"{LEVEL_LABEL}, 0 dB: the truth's maximum")
                if first is not None and (picture := seen(dataset, frame, cameras)) is not None:
                    axes[2].clear()
                    draw_camera(axes[2], picture)
                    axes[2].set_title("camera at the sensor")
                speed = float(np.linalg.norm(frame.sensor_velocity))
                figure.suptitle(
                    f"{figure_text(frame.scene)}, sequence {sequence.number} ({sequence.split}), frame "
                    f"{frame.frame_id}: {frame.time:.2f} s, {speed:.1f} m/s"
                )
                writer.grab_frame()
        return film.read_bytes()


def _truth(frame: Frame) -> NDArray[np.float32]:
    """[R, U] magnitudes of a frame's truth [sqrt(W)]."""
    return frame.image * np.float32(frame.image_peak)


def _pictures_a_second(frames: Sequence[Frame]) -> int:
    """As fast as it was, within what can be seen."""
    lasts_s = frames[-1].time - frames[0].time
    return round(float(np.clip((len(frames) - 1) / lasts_s, SLOWEST, FASTEST))) if lasts_s > 0.0 else SLOWEST
