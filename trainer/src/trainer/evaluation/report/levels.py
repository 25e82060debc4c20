"""Images of different units on one dB scale, as figures and report show them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.pictures import level_db, range_weighted
from trainer.run.targets import AMPLITUDE, PROBABILITY

REPORT_SPAN_DB = 60.0
"""Levels that the report keeps below 0 dB."""
STEPS = 255
"""A level is kept as a byte, 0 for the floor: steps of 0.24 dB."""


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


def own_levels(image: NDArray[np.floating], span_db: float = REPORT_SPAN_DB) -> NDArray[np.float64]:
    """Levels [dB] below the image's own maximum, for point targets."""
    return level_db(image, float(image.max()), span_db)


def to_bytes(levels_db: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Levels [dB] from -:data:`REPORT_SPAN_DB` to 0 as 0 to 255."""
    return np.rint(STEPS * (1.0 + np.maximum(levels_db / REPORT_SPAN_DB, -1.0))).astype(np.uint8)


def from_bytes(levels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """[dB], the inverse of :func:`to_bytes` within half a step."""
    return REPORT_SPAN_DB * (levels / STEPS - 1.0)
