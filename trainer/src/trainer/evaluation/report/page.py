"""``report.html``: one file that holds everything it shows and loads nothing, neither from the disk nor from the
network.

Of a frame it shows images of different units on one dB scale, the range-Doppler map or the peaks that its shard has of
it, and the picture of a camera at the sensor.
"""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import pyarrow as pa
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from shared.dataset import Frame
from shared.dataset.folder import Dataset, camera_path
from shared.physics.errors import InputError
from shared.pictures import COLOUR_MAP, level_db, range_weighted
from shared.radar import Radar
from shared.signal.spectrum import range_doppler
from trainer.run.imager import AMPLITUDE, PROBABILITY

REPORT_SPAN_DB = 60.0
"""Levels that the report keeps below 0 dB."""
STEPS = 255
"""A level is kept as a byte, 0 for the floor: steps of 0.24 dB."""
WHOLE, PEAKS = "range-Doppler map", "strongest Doppler peaks"
WIDTH = 800
QUALITY = 85


def scene_levels(
    image: NDArray[np.floating], unit: str, truth: NDArray[np.floating] | None, span_db: float = REPORT_SPAN_DB
) -> NDArray[np.float64]:
    """[R, U] levels [dB] of a scene, at most 0.

    Amplitudes are weighted by range first: an echo falls with R^2, and a picture has 40 dB. Images in sqrt(W) stand
    under the maximum of the truth, where there is one, so that too weak and too strong ones show; others under their
    own.

    :param truth: [R, U] magnitude [sqrt(W)] or None
    """
    shown = image if unit == PROBABILITY else range_weighted(image)
    reference = float(shown.max())
    if unit == AMPLITUDE and truth is not None and truth.any():
        reference = float(range_weighted(truth).max())
    return level_db(shown, reference, span_db)


def own_levels(image: NDArray[np.floating]) -> NDArray[np.float64]:
    """Levels [dB] below the image's own maximum, for point targets."""
    return level_db(image, float(image.max()), REPORT_SPAN_DB)


def to_bytes(levels_db: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Levels [dB] from -:data:`REPORT_SPAN_DB` to 0 as 0 to 255."""
    return np.rint(STEPS * (1.0 + np.maximum(levels_db / REPORT_SPAN_DB, -1.0))).astype(np.uint8)


def from_bytes(levels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """[dB], the inverse of :func:`to_bytes` within half a step."""
    return REPORT_SPAN_DB * (levels / STEPS - 1.0)


def doppler_map(frame: Frame, radar: Radar) -> tuple[str, NDArray[np.float64]]:
    """(:data:`WHOLE` or :data:`PEAKS`, [R, chirps] mean magnitude over channels on the rising velocity axis [sqrt(W)]).

    Of peaks alone the other cells are 0. An unfolded velocity stands in the cell that it folds to.
    """
    if frame.range_doppler is not None:
        return WHOLE, np.asarray(frame.range_doppler, dtype=np.float64)
    if frame.cube is not None:
        return WHOLE, np.abs(range_doppler(frame.cube, radar)).mean(axis=2).astype(np.float64)
    waveform = radar.waveform
    cells = waveform.doppler_cells(frame.velocity)
    magnitude = np.zeros((waveform.range_bins, waveform.chirps))
    rows = np.broadcast_to(np.arange(waveform.range_bins), cells.shape)
    magnitude[rows, cells] = np.abs(frame.range_channel).mean(axis=2)
    return PEAKS, magnitude


def small_picture(dataset: Dataset, frame_id: int) -> bytes:
    """JPEG of a frame's camera picture, at most :data:`WIDTH` pixels wide; empty where the dataset has none.

    :raises InputError: a file that is no picture
    """
    picture = dataset.camera(frame_id)
    if picture is None:
        return b""
    buffer = io.BytesIO()
    try:
        with Image.open(io.BytesIO(picture)) as image:
            image.thumbnail((WIDTH, WIDTH))
            image.convert("RGB").save(buffer, format="jpeg", quality=QUALITY)
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise InputError(
            camera_path(dataset.path, frame_id), f"no picture: {error}", "the file as render --camera wrote it"
        ) from error
    return buffer.getvalue()


SCALE = (
    "All images on one scale. Amplitudes are weighted by range; those in sqrt(W) stand under the maximum of the truth, "
    "relative ones and probabilities under their own. Where a pixel holds several bins, it shows the highest. Click "
    "into an image to move the cut. From above, every echo stands as if it came from the radar's own height."
)

SCRIPTS = ("levels.js", "places.js", "drawing.js", "frames.js", "numbers.js")
"""Of the page, in their order."""


@dataclass(frozen=True, eq=False)
class ReportFrame:
    """One frame to look at.

    :param name: shown in the list
    :param row: range bin where the cut starts
    :param images: by name, [R, U] bytes of levels (:func:`trainer.evaluation.report.page.to_bytes`); one is "truth"
    :param doppler: (its title, [R, chirps] bytes of levels over velocity), if known
    :param camera: JPEG of what a camera at the sensor sees; empty if there is none
    """

    name: str
    row: int
    images: Mapping[str, NDArray[np.uint8]]
    doppler: tuple[str, NDArray[np.uint8]] | None = None
    camera: bytes = b""


@dataclass(frozen=True)
class ReportFigure:
    """One picture, between its title and its caption in plain text."""

    title: str
    caption: str
    png: bytes


def report_page(
    title: str,
    summary: str,
    radar: Radar,
    frames: Sequence[ReportFrame],
    figures: Sequence[ReportFigure],
    table: pa.Table,
) -> str:
    """The page's HTML.

    :param summary: what was evaluated, one plain paragraph
    :param table: of :func:`trainer.evaluation.report.tables.metrics_table`
    """
    waveform, grid = radar.waveform, radar.grid
    data = {
        "axes": {
            "range_bins": waveform.range_bins, "range_step_m": waveform.range_step_m, "u_bins": grid.bins,
            "u_start": grid.u_start, "u_step": grid.step, "velocity_bins": waveform.chirps,
            "velocity_start": float(waveform.velocities_mps[0]), "velocity_step": waveform.velocity_step_mps,
        },
        "span_db": REPORT_SPAN_DB,
        "colours": np.rint(255.0 * colormaps[COLOUR_MAP](np.arange(256))[:, :3]).astype(int).tolist(),
        "frames": [{"name": frame.name, "row": frame.row} for frame in frames],
        "table": {
            "columns": table.column_names,
            "rows": [list(values) for values in zip(*(column.to_pylist() for column in table.columns), strict=True)],
        },
    }  # fmt: skip
    parts = {
        "title": html.escape(title),
        "summary": html.escape(summary),
        "scale": html.escape(SCALE),
        "figures": "\n".join(_figure(figure) for figure in figures),
        "data": _json(data),
        "frames": "\n".join(_pictures(place, frame) for place, frame in enumerate(frames)),
        "style": _viewer("style.css"),
        "script": "\n".join(map(_viewer, SCRIPTS)),
    }
    # All marks of the page at once: text inside a part that looks like a mark stays text.
    return re.sub(r"{{(.*?)}}", lambda mark: parts[mark[1]], _viewer("page.html"))


def _pictures(place: int, frame: ReportFrame) -> str:
    """An element of its own for each frame: the page parses those that are looked at."""
    pictures = {
        "images": {name: _png(image) for name, image in frame.images.items()},
        "doppler": frame.doppler and {"title": frame.doppler[0], "png": _png(frame.doppler[1])},
        "camera": base64.b64encode(frame.camera).decode(),
    }
    return f'<script type="application/json" id="frame-{place}">{_json(pictures)}</script>'


def _json(value: object) -> str:
    """JSON that may stand in a script element.

    "</script" would end it, and "<!--<script" would keep it from ending. JSON allows the escape; what is not ASCII,
    U+2028 among it, is escaped already.
    """
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def _viewer(name: str) -> str:
    return files("trainer.evaluation.report").joinpath("viewer", name).read_text(encoding="utf-8")


def _figure(figure: ReportFigure) -> str:
    title, picture = html.escape(figure.title), base64.b64encode(figure.png).decode()
    return (
        f'<figure><img alt="{title}" src="data:image/png;base64,{picture}">'
        f'<figcaption class="note">{html.escape(figure.caption)}</figcaption></figure>'
    )


def _png(levels: NDArray[np.uint8]) -> str:
    """Base64 of a grey PNG of ``levels``, row 0 first."""
    buffer = io.BytesIO()
    # The values are stored as they are: a colour map would lower one level in twelve by one.
    Image.fromarray(levels).save(buffer, format="png")
    return base64.b64encode(buffer.getvalue()).decode()
