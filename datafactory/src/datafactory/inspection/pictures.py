"""Pictures of a dataset's frames: what thinned and full arrays make of them, the truth, the scene from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from datafactory.view.camera import draw_camera
from datafactory.view.cameras import Cameras, seen
from shared.dataset import Box, Frame
from shared.dataset.boxes import footprint, range_and_u
from shared.dataset.folder import Dataset
from shared.dataset.reading import radar_of, read_frame
from shared.physics.errors import InputError, figure_text
from shared.pictures import LEVEL_LABEL, draw_from_above, draw_levels, range_weighted_db, save_figure
from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.signal.imaging import delay_and_sum

PANEL_INCHES, PLANE_INCHES, HEIGHT_INCHES = 1.75, 4.4, 5.2
"""Widths of a panel over u and of the view from above, and the height: read at the width of a page, 900 pixels."""

TRUTH_TITLE = "truth"
MARK_COLOUR = "cyan"
"""Of targets: a colour that the levels do not have."""
BOX_COLOURS = {"car": "cyan", "truck": "deepskyblue", "bus": "deepskyblue", "pedestrian": "lime", "bicycle": "white"}
"""Of boxes by class; a street has too many for a name beside each."""
OTHER_COLOUR = "0.6"
"""Of the boxes of all other classes."""


def write_pictures(dataset: Dataset, count: int, folder: Path, cameras: Cameras | None = None) -> list[Path]:
    """Draw ``count`` frames spread evenly over the dataset, as ``frame-NNNNNN.png``.

    The camera pictures that were written with the frames stand beside them.

    :param cameras: make those that were not

    :raises InputError: a folder that cannot be written, a shard that is damaged, a scene that is not what it was
    """
    rows = [(split, *place) for split in dataset.splits for place in dataset.rows(split)]
    chosen = sorted({round(place) for place in np.linspace(0, len(rows) - 1, min(count, len(rows)))})
    radar = radar_of(dataset.description(), dataset.path)
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
    waveform, angles = radar.waveform, radar.grid
    figure = Figure(figsize=(PANEL_INCHES * len(levels) + PLANE_INCHES, HEIGHT_INCHES), layout="constrained")
    ratios = [*[PANEL_INCHES] * len(levels), PLANE_INCHES]
    grid = figure.add_gridspec(2, len(ratios), width_ratios=ratios)
    axes = [figure.add_subplot(grid[:, column]) for column in range(len(levels))]
    for axis, (title, level) in zip(axes, levels.items(), strict=True):
        drawn = draw_levels(axis, level, waveform.range_step_m, angles.u_start, angles.step)
        axis.set(title=title, xlabel="u = sin(azimuth)")
        _draw_boxes(axis, frame)
        axis.label_outer()
    axes[0].set_ylabel("range [m]")
    if camera is None:
        plane = figure.add_subplot(grid[:, -1])
    else:
        draw_camera(above := figure.add_subplot(grid[0, -1]), camera)
        above.set_title("camera at the sensor")
        plane = figure.add_subplot(grid[1, -1])
    draw_from_above(plane, levels[TRUTH_TITLE], waveform.range_step_m, angles.u)
    _mark_targets(plane, frame)
    _outline_boxes(plane, frame)
    plane.set(title="truth from above", xlabel="y, to the left [m]", ylabel="x, ahead [m]")
    _level_bar(figure, drawn, axes)
    speed = float(np.linalg.norm(frame.sensor_velocity))
    figure.suptitle(
        f"{figure_text(frame.scene)}, frame {frame.frame_id} ({', '.join(filter(None, (split, frame.kind)))}), "
        f"sensor at {speed:.1f} m/s"
    )
    return figure


def _level_bar(figure: Figure, drawn: AxesImage, axes: list[Axes]) -> None:
    figure.colorbar(
        drawn, ax=axes, location="left", aspect=40, pad=0.01, label=f"{LEVEL_LABEL}, 0 dB: the truth's maximum"
    )


def _images(frame: Frame, radar: Radar) -> dict[str, NDArray[np.floating]]:
    """Magnitudes [R, U] in sqrt(W) by panel title."""
    strongest = frame.range_channel[0]
    rx_count = len(radar.array.rx_m)
    images = {f"{rx_count} RX": np.abs(delay_and_sum(strongest, radar))}
    for name, rx in AVR_QDM_110_THINNED_RX.items():
        # The thinned sets are those of the paper's array; another array has only itself.
        if name != "full" and rx_count == len(AVR_QDM_110_THINNED_RX["full"]):
            thinned = delay_and_sum(strongest, radar, radar.array.channel_indices(rx))
            images[f"{len(rx)} RX ({name})"] = np.abs(thinned)
    images[TRUTH_TITLE] = frame.image * np.float32(frame.image_peak)
    return images


def _draw_boxes(axis: Axes, frame: Frame) -> None:
    """The boxes' outlines over an image: their footprints, at the height of their middles."""
    limits = axis.get_xlim(), axis.get_ylim()
    for box in frame.boxes:
        range_m, u = range_and_u(box)
        style = "-" if box.power > 0.0 else ":"
        axis.plot(np.append(u, u[0]), np.append(range_m, range_m[0]), style, color=_colour(box), linewidth=0.6)
    axis.set(xlim=limits[0], ylim=limits[1])


def _outline_boxes(axis: Axes, frame: Frame) -> None:
    """The boxes from above, and what their colours mean."""
    named = dict[str, str]()
    for box in frame.boxes:
        style = "-" if box.power > 0.0 else ":"
        outline = footprint(box)[:, ::-1]
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
