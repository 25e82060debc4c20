"""Two targets from an image row: where its two highest peaks stand, and whether they are the two targets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from shared.physics.errors import InputError


def strongest_peaks(image: NDArray[np.floating], u: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """[R, count] angles of the largest local maxima of each row of an image [R, U], rising; NaN for those missing."""
    found = np.full((len(image), count), np.nan)
    for row, spectrum in enumerate(image):
        peaks, _ = find_peaks(spectrum)
        best = peaks[np.argsort(spectrum[peaks], kind="stable")[::-1][:count]]
        found[row, : len(best)] = np.sort(np.asarray(u)[best])
    return found


def resolved(found: NDArray[np.floating], true: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[T] whether both errors are below half the separation; found and true are [T, 2], both rising.

    :raises InputError: not two angles each
    """
    if np.shape(found) != np.shape(true) or np.ndim(true) != 2 or np.shape(true)[1] != 2:
        raise InputError("resolution", f"shapes {np.shape(found)} and {np.shape(true)}", "[trials, 2] both")
    half = 0.5 * (true[:, 1] - true[:, 0])
    # NaN, a target not found, compares false.
    return np.all(np.abs(found - true) < half[:, None], axis=1)
