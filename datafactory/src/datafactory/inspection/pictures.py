"""A dataset's frames as pictures: what thinned and full arrays make of them, the truth, the scene from above.

A sequence is an animation: what the array measures, the truth, and what a camera at the sensor sees.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from datafactory.view.camera import Cameras, draw_camera, seen
from shared.dataset import Box, Frame
from shared.dataset.folder import Dataset
from shared.dataset.locations import Location, local
from shared.dataset.reading import radar_of, read_frame
from shared.dataset.writing import write_bytes
from shared.physics.errors import InputError, figure_text
from shared.pictures import LEVEL_LABEL, draw_from_above, draw_levels, film, range_weighted_db, save_figure
from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.signal.imaging import delay_and_sum

PANEL_INCHES, PLANE_INCHES, HEIGHT_INCHES = 1.75, 4.4, 5.2
"""Widths of a panel over u and of the view from above, and the height: read at the width of a page, 900 pixels."""

TRUTH_TITLE, TRUTH_LEVEL = "truth", f"{LEVEL_LABEL}, 0 dB: the truth's maximum"
MARK_COLOUR = "cyan"
"""Of targets: a colour that the levels do not have."""
BOX_COLOURS = {"car": "cyan", "truck": "deepskyblue", "bus": "deepskyblue", "pedestrian": "lime", "bicycle": "white"}
"""Of boxes by class; a street has too many for a name beside each."""
OTHER_COLOUR = "0.6"
"""Of the boxes of all other classes."""
MOST_PICTURES = 60
"""Of one animation; a longer sequence is shown in strides."""
LARGEST_BYTES = 3_000_000
"""Of the file: where it is larger, every second picture is left out, until it is not."""
DOTS_PER_INCH = 72
FASTEST, SLOWEST = 20, 1
"""Pictures a second; in between as fast as it was."""
TITLES = ("measured, delay-and-sum", "truth")


def write_pictures(dataset: Dataset, count: int, folder: Path, cameras: Cameras | None = None) -> list[Path]:
    """Draw ``count`` frames spread evenly over the dataset, as ``frame-NNNNNN.png``.

    The camera pictures that were written with the frames stand beside them.

    :param cameras: make those that were not
    :raises InputError: a folder that cannot be written, a shard that is damaged, a scene that is not what it was
    """
    rows = [(split, *place) for split in dataset.splits for place in dataset.rows(split)]
    chosen = sorted({round(place) for place in np.linspace(0, len(rows) - 1, min(count, len(rows)))})
    radar = radar_of(dataset.description(), dataset.path)
    folder = local(folder, "--out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("--out", f"{folder}: {error.strerror}", "a folder that can be written") from error
    pictures = []
    for split, shard, row in (rows[index] for index in chosen):
        frame = read_frame(shard, row, columns=("range_channel", "image", "targets", "boxes"))
        path = folder / f"frame-{frame.frame_id:06d}.png"
        save_figure(draw_frame(frame, radar, split, seen(dataset, frame, cameras)), path, dpi=150)
        pictures.append(path)
    return pictures


def draw_frame(frame: Frame, radar: Radar, split: str = "", camera: NDArray[np.uint8] | None = None) -> Figure:
    """One frame side by side: delay-and-sum of the thinned and the full arrays, the truth over u and from above.

    Levels are those of amplitude x range, 0 dB at the truth's maximum. Left of the radar is on the left in every panel.
    Boxes are drawn over all of them, dotted where the radar does not see what is in them.

    :param camera: what a camera at the sensor sees, above the last of them
    """
    images = _images(frame, radar)
    truth = images[TRUTH_TITLE]
    reference = truth if truth.any() else np.maximum.reduce(list(images.values()))
    levels = {title: range_weighted_db(image, reference=reference) for title, image in images.items()}
    figure = Figure(figsize=(PANEL_INCHES * len(levels) + PLANE_INCHES, HEIGHT_INCHES), layout="constrained")
    ratios = [*[PANEL_INCHES] * len(levels), PLANE_INCHES]
    grid = figure.add_gridspec(2, len(ratios), width_ratios=ratios)
    axes = [figure.add_subplot(grid[:, column]) for column in range(len(levels))]
    for axis, (title, level) in zip(axes, levels.items(), strict=True):
        drawn = _panel(axis, title, level, radar)
        _draw_boxes(axis, frame)
    axes[0].set_ylabel("range [m]")
    if camera is not None:
        draw_camera(above := figure.add_subplot(grid[0, -1]), camera)
        above.set_title("camera at the sensor")
    plane = figure.add_subplot(grid[:, -1] if camera is None else grid[1, -1])
    draw_from_above(plane, levels[TRUTH_TITLE], radar.waveform.range_step_m, radar.grid.u)
    _mark_targets(plane, frame)
    _outline_boxes(plane, frame)
    plane.set(title="truth from above", xlabel="y, to the left [m]", ylabel="x, ahead [m]")
    figure.colorbar(drawn, ax=axes, location="left", aspect=40, pad=0.01, label=TRUTH_LEVEL)
    speed = float(np.linalg.norm(frame.sensor_velocity))
    figure.suptitle(
        f"{figure_text(frame.scene)}, frame {frame.frame_id} ({', '.join(filter(None, (split, frame.kind)))}), "
        f"sensor at {speed:.1f} m/s"
    )
    return figure


def _panel(axis: Axes, title: str, levels: NDArray[np.floating], radar: Radar) -> AxesImage:
    """Levels [R, U] [dB] over u, under a title."""
    drawn = draw_levels(axis, levels, radar.waveform.range_step_m, radar.grid.u_start, radar.grid.step)
    axis.set(title=title, xlabel="u = sin(azimuth)")
    axis.label_outer()
    return drawn


def _images(frame: Frame, radar: Radar) -> dict[str, NDArray[np.floating]]:
    """Magnitudes [R, U] in sqrt(W) by panel title."""
    strongest = frame.range_channel[0]
    rx_count = len(radar.array.rx_m)
    # Channels of other heights see elevation too, and would draw bars across u.
    images = {f"{rx_count} RX": np.abs(delay_and_sum(strongest, radar, radar.array.azimuth_channels))}
    for name, rx in AVR_QDM_110_THINNED_RX.items():
        # The thinned sets are those of the paper's array; another array has only itself.
        if name != "full" and rx_count == len(AVR_QDM_110_THINNED_RX["full"]):
            thinned = delay_and_sum(strongest, radar, radar.array.channel_indices(rx))
            images[f"{len(rx)} RX ({name})"] = np.abs(thinned)
    images[TRUTH_TITLE] = _truth(frame)
    return images


def _draw_boxes(axis: Axes, frame: Frame) -> None:
    """The boxes' outlines over an image: their footprints, at the height of their middles."""
    limits = axis.get_xlim(), axis.get_ylim()
    for box in frame.boxes:
        range_m, u = box.range_and_u()
        style = "-" if box.power > 0.0 else ":"
        axis.plot(np.append(u, u[0]), np.append(range_m, range_m[0]), style, color=_colour(box), linewidth=0.6)
    axis.set(xlim=limits[0], ylim=limits[1])


def _outline_boxes(axis: Axes, frame: Frame) -> None:
    """The boxes from above, and what their colours mean."""
    named = dict[str, str]()
    for box in frame.boxes:
        style = "-" if box.power > 0.0 else ":"
        outline = box.footprint()[:, ::-1]
        axis.add_patch(Polygon(outline, fill=False, edgecolor=_colour(box), linestyle=style, linewidth=0.8))
        named[box.class_name if box.class_name in BOX_COLOURS else "other classes"] = _colour(box)
    for name, colour in named.items():
        axis.plot([], [], color=colour, linewidth=0.8, label=name)
    if named:
        axis.legend(loc="upper right", fontsize="small", facecolor="0.25", labelcolor="white")


def _colour(box: Box) -> str:
    return BOX_COLOURS.get(box.class_name, OTHER_COLOUR)


def _mark_targets(axis: Axes, frame: Frame) -> None:
    """Rings round the objects of known cross section: x = r sqrt(1 - u^2), y = r u, as if at the radar's height."""
    named = [target for target in frame.targets if target.object]
    if not named:
        return
    range_m, u = np.array([target.range_m for target in named]), np.array([target.u for target in named])
    x, y = range_m * np.sqrt(np.maximum(1.0 - u**2, 0.0)), range_m * u
    axis.scatter(y, x, s=60.0, facecolors="none", edgecolors=MARK_COLOUR, linewidths=0.8, label="objects")
    axis.legend(loc="upper right")


class SequenceRows(NamedTuple):
    """A sequence by its number: its split, and shard and row of its frames in the order of time."""

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
            whole = _film(dataset, sequence, sequence.rows[::stride], radar, cameras)
            if len(whole) < LARGEST_BYTES or stride >= len(sequence.rows):
                break
            stride *= 2
        write_bytes(path, whole)
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

    def drawn() -> Iterator[Frame]:
        for number, frame in enumerate(frames):
            images = np.abs(delay_and_sum(frame.range_channel[0], radar)), _truth(frame)
            for axis, image, title in zip(axes, images, TITLES, strict=False):
                for artist in list(axis.images):
                    artist.remove()
                levels = _panel(axis, title, range_weighted_db(image, reference=brightest), radar)
            if number == 0:
                axes[0].set_ylabel("range [m]")
                figure.colorbar(levels, ax=axes[:2], label=TRUTH_LEVEL)
            if first is not None and (picture := seen(dataset, frame, cameras)) is not None:
                axes[2].clear()
                draw_camera(axes[2], picture)
                axes[2].set_title("camera at the sensor")
            speed = float(np.linalg.norm(frame.sensor_velocity))
            figure.suptitle(
                f"{figure_text(frame.scene)}, sequence {sequence.number} ({sequence.split}), frame "
                f"{frame.frame_id}: {frame.time:.2f} s, {speed:.1f} m/s"
            )
            yield frame

    lasts_s = frames[-1].time - frames[0].time
    as_it_was = (len(frames) - 1) / lasts_s if lasts_s > 0.0 else SLOWEST  # pictures a second
    return film(figure, drawn(), round(float(np.clip(as_it_was, SLOWEST, FASTEST))))


def _truth(frame: Frame) -> NDArray[np.float32]:
    """[R, U] magnitudes of a frame's truth [sqrt(W)]."""
    return frame.image * np.float32(frame.image_peak)
