"""Magnitudes as levels that a picture can show."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from shared.physics.units import amplitude_to_db

SPAN_DB = 40.0
"""Levels shown below 0 dB [dB]."""


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
