"""One look for all pictures of range-angle images, whoever draws them: one colour map, one span, the radar's left on
the left, no target lost between the pixels.

Matplotlib is not imported here: axes and figures are those of the caller.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float64

from shared.dataset.writing import atomic
from shared.physics.units import amplitude_to_db

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

SPAN_DB = 40.0
"""Levels shown below 0 dB [dB]."""
COLOUR_MAP = "magma"
"""Rises evenly in lightness, so that it also reads in grey."""
LEVEL_LABEL = "amplitude x range [dB]"
OUTSIDE = "#e1e1e1"
"""What lies beyond the field of view."""
PANEL_PIXELS = 320, 300
"""Height and width of a panel, unless the caller knows better."""


def level_db(
    image: Float[np.ndarray, "*shape"], reference: float, span_db: float = SPAN_DB
) -> Float64[np.ndarray, "*shape"]:
    """Level of magnitudes over ``reference`` [dB], cut at -``span_db`` and 0; the floor where there is no reference."""
    if not reference > 0.0:
        return np.full(np.shape(image), -span_db)
    return np.clip(amplitude_to_db(np.asarray(image, dtype=np.float64) / reference), -span_db, 0.0)


def range_weighted(image: Float[np.ndarray, "rows columns"]) -> Float64[np.ndarray, "rows columns"]:
    """[R, U] amplitudes times range bin.

    An echo's amplitude falls with R^2 and a picture has 40 dB: without the weight only the nearest metres would show.
    """
    return np.asarray(image, dtype=np.float64) * np.arange(len(image))[:, None]


def range_weighted_db(
    image: Float[np.ndarray, "rows columns"],
    span_db: float = SPAN_DB,
    reference: Float[np.ndarray, "rows columns"] | None = None,
) -> Float64[np.ndarray, "rows columns"]:
    """[R, U] level below the maximum of the image, or of a reference, weighted by range,
    from -``span_db`` to 0 [dB]."""
    weighted = range_weighted(image)
    brightest = (weighted if reference is None else range_weighted(reference)).max()
    return level_db(weighted, float(brightest), span_db)


def hold_peaks(
    levels_db: Float[np.ndarray, "rows columns"], pixels: tuple[int, int]
) -> tuple[Float[np.ndarray, "held_rows held_columns"], int, int]:
    """(the highest level of every block of bins, the rows and columns of a block), at most ``pixels`` blocks.

    A panel has fewer pixels than an image has bins, and a target is one bin: drawn by the nearest, two of three vanish.
    The last blocks may hold fewer bins.
    """
    rows, columns = (-(-bins // most) for bins, most in zip(levels_db.shape, pixels, strict=True))
    held = np.maximum.reduceat(levels_db, np.arange(0, levels_db.shape[0], rows), axis=0)
    return np.maximum.reduceat(held, np.arange(0, levels_db.shape[1], columns), axis=1), rows, columns


def draw_levels(
    axis: Axes,
    levels_db: Float[np.ndarray, "rows columns"],
    range_step_m: float,
    u_start: float,
    u_step: float,
    first_row: int = 0,
    pixels: tuple[int, int] = PANEL_PIXELS,
) -> AxesImage:
    """Levels [n, U] of the range bins from ``first_row`` on over u, which rises to the left.

    :param levels_db: from -:data:`SPAN_DB` to 0
    :param pixels: height and width of the panel, at most so many blocks are drawn
    """
    held, rows, columns = hold_peaks(levels_db, pixels)
    near, far = ((first_row - 0.5 + count) * range_step_m for count in (0, rows * held.shape[0]))
    right, left = (u_start + (count - 0.5) * u_step for count in (0, columns * held.shape[1]))
    drawn = axis.imshow(
        held[:, ::-1], origin="lower", aspect="auto", cmap=COLOUR_MAP, vmin=-SPAN_DB, vmax=0.0,
        extent=(left, right, near, far), interpolation="nearest",
    )  # fmt: skip
    bins = levels_db.shape
    axis.set(xlim=(right + bins[1] * u_step, right), ylim=(max(near, 0.0), near + bins[0] * range_step_m))
    axis.locator_params(axis="x", nbins=4)  # labels stay apart in the narrowest panel
    return drawn


def draw_from_above(
    axis: Axes,
    levels_db: Float[np.ndarray, "rows columns"],
    range_step_m: float,
    u: Float[np.ndarray, " columns"],
    pixels: tuple[int, int] = PANEL_PIXELS,
) -> QuadMesh:
    """Levels [R, U] of the range bins from 0 on in the plane: x = r sqrt(1 - u^2) ahead, y = r u to the left [m].

    As if every echo came from the radar's own height.

    :param levels_db: from -:data:`SPAN_DB` to 0
    :param u: [U] rising evenly
    """
    held, rows, columns = hold_peaks(levels_db, pixels)
    step = u[1] - u[0] if len(u) > 1 else 2.0
    range_edges = (np.minimum(rows * np.arange(held.shape[0] + 1), len(levels_db)) - 0.5).clip(0.0) * range_step_m
    angle_edges = u[0] + (np.minimum(columns * np.arange(held.shape[1] + 1), len(u)) - 0.5) * step
    angle_edges = np.clip(angle_edges, -1.0, 1.0)
    x, y = np.outer(range_edges, np.sqrt(1.0 - angle_edges**2)), np.outer(range_edges, angle_edges)
    drawn = axis.pcolormesh(y, x, held, cmap=COLOUR_MAP, vmin=-SPAN_DB, vmax=0.0, rasterized=True)
    axis.set(aspect="equal", facecolor=OUTSIDE, xlim=(float(y.max()), float(y.min())), ylim=(0.0, float(x.max())))
    return drawn


@contextmanager
def any_name() -> Iterator[None]:
    """Draw names of any script without a word: a box stands for what the font does not have."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def save_figure(figure: Figure, path: Path, dpi: int) -> None:
    """Write a PNG, whole or not at all; it names no version of matplotlib, so that its bytes do not depend on it."""
    with atomic(path) as partial, any_name():
        figure.savefig(partial, format="png", dpi=dpi, metadata={"Software": None})


def film(figure: Figure, pictures: Iterable[object], pictures_a_second: int) -> bytes:
    """A GIF of a figure as it is after each step of ``pictures``, which draw in it."""
    from matplotlib.animation import PillowWriter

    writer = PillowWriter(fps=pictures_a_second)
    # The writer tells the format by the file's name, and leaves half a file where it fails.
    with TemporaryDirectory() as scratch, any_name():
        whole = Path(scratch) / "film.gif"
        with writer.saving(figure, str(whole), figure.dpi):
            for _ in pictures:
                writer.grab_frame()
        return whole.read_bytes()
