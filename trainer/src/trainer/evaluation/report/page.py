"""``report.html``: one file that holds everything it shows and loads nothing, neither from the disk nor from the
network."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import pyarrow as pa
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image

from shared.pictures import COLOUR_MAP
from shared.radar import Radar
from trainer.evaluation.report.shown import REPORT_SPAN_DB

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
    :param images: by name, [R, U] bytes of levels (:func:`trainer.evaluation.report.shown.to_bytes`); one is "truth"
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
    """One picture.

    :param title: above it
    :param caption: below it, plain text
    :param png: its file
    """

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
    page = _viewer("page.html")
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
    # One split at the marks of the page: text inside a part that looks like a mark stays text.
    pieces = page.split("{{")
    filled = [pieces[0]]
    for piece in pieces[1:]:
        name, rest = piece.split("}}", maxsplit=1)
        filled += [parts[name], rest]
    return "".join(filled)


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
    picture = base64.b64encode(figure.png).decode()
    title, caption = html.escape(figure.title), html.escape(figure.caption)
    return (
        f'<figure><img alt="{title}" src="data:image/png;base64,{picture}">'
        f'<figcaption class="note">{caption}</figcaption></figure>'
    )


def _png(levels: NDArray[np.uint8]) -> str:
    """Base64 of a grey PNG of ``levels``, row 0 first."""
    buffer = io.BytesIO()
    # The values are stored as they are: a colour map would lower one level in twelve by one.
    Image.fromarray(levels).save(buffer, format="png")
    return base64.b64encode(buffer.getvalue()).decode()
