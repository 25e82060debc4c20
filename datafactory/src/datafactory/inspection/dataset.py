"""What is in a dataset: its numbers, and pictures of some of its frames."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from datafactory.view.camera import camera_picture, draw_camera
from datafactory.view.cameras import Cameras, stored_picture
from shared.dataset import Frame
from shared.dataset.boxes import footprint, range_and_u
from shared.dataset.folder import MANIFEST, Dataset
from shared.dataset.reading import radar_of, read_frame
from shared.dataset.writing import atomic
from shared.physics.errors import InputError, figure_text
from shared.physics.units import amplitude_to_db
from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.signal.imaging import delay_and_sum

SPAN_DB = 60.0
"""Span of the colour bar, down from the brightest cell [dB]."""

CAMERA_ABOVE = (1.0, 1.7)
"""Heights of a camera picture and of the top view below it."""

BOX_COLOUR = "tab:red"
"""Of boxes, in all panels."""

NARROWEST_VIEW_M = 25.0
"""Half width of the top view where all targets are near the axis [m]."""


@dataclass(frozen=True)
class Summary:
    """The numbers of a dataset.

    :param frames: (split, kind) to number of frames; empty for a folder of traced paths alone
    :param scenes: scene name to number of frames
    :param traced: frames whose traced paths are stored
    :param radar: its name; "" where there are no frames
    :param shapes: array columns and their shapes
    :param shards: number of shards
    :param bytes: size of all shards
    :param counts: what the manifest counted, e.g. what was left out
    """

    frames: dict[tuple[str, str], int]
    scenes: dict[str, int]
    traced: int
    radar: str
    shapes: dict[str, list[int]]
    shards: int
    bytes: int
    counts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """What ``datafactory inspect --json`` prints: ``frames`` by split, then by kind; the rest as it stands here."""
        by_split: dict[str, dict[str, int]] = {}
        for (split, kind), count in self.frames.items():
            by_split.setdefault(split, {})[kind] = count
        return {**vars(self), "frames": by_split, "counts": dict(self.counts)}


def summarise(dataset: Dataset) -> Summary:
    """Count a dataset's frames; only the columns of a few bytes are read.

    :raises InputError: a shard that is damaged
    """
    kinds: Counter[tuple[str, str]] = Counter()
    scenes: Counter[str] = Counter()
    for split in dataset.splits:
        for frame in dataset.frames(split, columns=()):
            kinds[split, frame.kind] += 1
            scenes[frame.scene] += 1
    counts = dataset.manifest.get("counts", {})
    if not isinstance(counts, dict):
        raise InputError(dataset.path / MANIFEST, f"counts = {counts!r}", "a number for each thing counted")
    description: dict[str, Any] = dataset.description() if dataset.splits else {"radar": {"name": ""}, "shapes": {}}
    return Summary(
        frames=dict(kinds),
        scenes=dict(scenes),
        traced=sum(record.rows for record in dataset.records if record.path.startswith("paths/")),
        radar=description["radar"]["name"],
        shapes=description["shapes"],
        shards=len(dataset.records),
        bytes=sum(record.bytes for record in dataset.records),
        counts=counts,
    )


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
        camera = stored_picture(dataset, frame.frame_id)
        if camera is None and cameras is not None and (subject := cameras.subject(frame)) is not None:
            camera = camera_picture(subject)
        # No software version in the file: the same frame gives the same bytes.
        with atomic(path) as partial, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing from font")  # a scene's name may be of any script
            draw_frame(frame, radar, split, camera).savefig(partial, format="png", dpi=150, metadata={"Software": None})
        pictures.append(path)
    return pictures


def draw_frame(frame: Frame, radar: Radar, split: str = "", camera: NDArray[np.uint8] | None = None) -> Figure:
    """One frame side by side: delay-and-sum of the full and the thinned arrays, the truth, the targets from above.

    :param camera: what a camera at the sensor sees, above the last of them

    Boxes are drawn over the images and the top view, dashed where the radar does not see what is in them.

    All levels are 20 log10(|A| r) below the brightest cell: amplitudes fall with r^2, and without the weight the first
    metres would outshine the rest. Left of the radar is on the left in every panel.
    """
    range_m = radar.waveform.ranges_m
    images = _images(frame, radar)
    levels = {title: amplitude_to_db(image * range_m[:, None]) for title, image in images.items()}
    brightest = max(float(level.max()) for level in levels.values())
    norm = Normalize(-SPAN_DB, 0.0)

    figure = Figure(figsize=(3.3 * len(levels) + (6.0 if camera is None else 7.5), 7.5), layout="constrained")
    grid = figure.add_gridspec(2, len(levels) + 1, width_ratios=[*[1.0] * len(levels), 1.7 if camera is None else 2.2])
    axes = [figure.add_subplot(grid[:, column]) for column in range(len(levels))]
    if camera is None:
        axes.append(figure.add_subplot(grid[:, -1]))
    else:
        grid.set_height_ratios(CAMERA_ABOVE)
        draw_camera(seen := figure.add_subplot(grid[0, -1]), camera)
        seen.set_title("camera at the sensor")
        axes.append(figure.add_subplot(grid[1, -1]))
    for axis, (title, level) in zip(axes, levels.items(), strict=False):
        _draw_image(axis, level - brightest, radar, norm)
        axis.set_title(title)
        _draw_boxes(axis, frame)
    axes[0].set_ylabel("range r [m]")
    points = _draw_targets(axes[-1], frame, radar, brightest, norm)
    figure.colorbar(points, ax=axes, label="|A| x r below the brightest cell [dB]", pad=0.01, extend="min")
    speed = float(np.linalg.norm(frame.sensor_velocity))
    figure.suptitle(
        f"{figure_text(frame.scene)}, frame {frame.frame_id} ({', '.join(filter(None, (split, frame.kind)))}), "
        f"sensor at {speed:.1f} m/s; levels weighted x r, 0 dB = {brightest:.1f} dB(sqrt(W) m)"
    )
    return figure


def _images(frame: Frame, radar: Radar) -> dict[str, NDArray[np.floating]]:
    """Magnitudes [R, U] in sqrt(W) by panel title."""
    strongest = frame.range_channel[0]
    rx_count = len(radar.array.rx_m)
    images = {f"DaS, {rx_count} RX": np.abs(delay_and_sum(strongest, radar))}
    for name, rx in AVR_QDM_110_THINNED_RX.items():
        # The thinned sets are those of the paper's array; another array has only itself.
        if name != "full" and rx_count == len(AVR_QDM_110_THINNED_RX["full"]):
            thinned = delay_and_sum(strongest, radar, radar.array.channel_indices(rx))
            images[f"DaS, {len(rx)} RX ({name})"] = np.abs(thinned)
    images[f"truth, {radar.virtual_sensor.channels} virtual elements"] = frame.image * np.float32(frame.image_peak)
    return images


def _draw_image(axis: Axes, level_db: NDArray[np.float64], radar: Radar, norm: Normalize) -> None:
    u, range_m = radar.grid.u, radar.waveform.ranges_m
    du, dr = radar.grid.step / 2.0, radar.waveform.range_step_m / 2.0
    extent = (u[0] - du, u[-1] + du, range_m[0] - dr, range_m[-1] + dr)
    axis.imshow(level_db, norm=norm, extent=extent, origin="lower", aspect="auto", interpolation="nearest")
    axis.invert_xaxis()
    axis.set_xlabel("u = sin(azimuth) [1], left > 0")


def _draw_boxes(axis: Axes, frame: Frame) -> None:
    """The boxes' outlines over an image: their footprints at the height of their middles."""
    limits = axis.get_xlim(), axis.get_ylim()
    for box in frame.boxes:
        range_m, u = range_and_u(box)
        style = "-" if box.power > 0.0 else ":"
        axis.plot(np.append(u, u[0]), np.append(range_m, range_m[0]), style, color=BOX_COLOUR, linewidth=0.8)
    axis.set(xlim=limits[0], ylim=limits[1])


def _draw_targets(axis: Axes, frame: Frame, radar: Radar, brightest: float, norm: Normalize) -> Any:
    """Top view: x = r sqrt(1 - u^2) and y = r u, as if every target were at the radar's height."""
    weakest_first = frame.targets[::-1]
    range_m = np.array([target.range_m for target in weakest_first])
    u = np.array([target.u for target in weakest_first])
    level = np.array([target.amplitude_db for target in weakest_first]) + amplitude_to_db(range_m) - brightest
    named = np.array([bool(target.object) for target in weakest_first], dtype=bool)
    x, y = range_m * np.sqrt(np.maximum(1.0 - u**2, 0.0)), range_m * u
    points = axis.scatter(y, x, c=level, norm=norm, s=14.0, linewidths=0.0)
    axis.scatter(y[named], x[named], s=60.0, facecolors="none", edgecolors="tab:red", linewidths=0.8, label="objects")
    for box in frame.boxes:
        style = "-" if box.power > 0.0 else ":"
        axis.add_patch(
            Polygon(footprint(box)[:, ::-1], fill=False, edgecolor=BOX_COLOUR, linestyle=style, linewidth=1.0)
        )
        axis.annotate(figure_text(box.class_name), box.center[1::-1], color=BOX_COLOUR, fontsize=7, clip_on=True)
    axis.plot(0.0, 0.0, marker="^", color="black", markersize=8, linestyle="none", label="sensor")
    half = max(NARROWEST_VIEW_M, 1.05 * float(np.abs(y).max(initial=0.0)))
    axis.set(xlim=(half, -half), ylim=(-2.0, float(radar.waveform.ranges_m[-1])), facecolor="0.93")
    axis.set_aspect("equal")
    axis.set(title=f"{len(frame.targets)} targets from above", xlabel="y [m], left > 0", ylabel="x [m], ahead")
    axis.legend(loc="upper right")
    return points
