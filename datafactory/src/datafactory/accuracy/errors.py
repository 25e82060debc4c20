"""What "error" means in every table here; all in dB, finite, with a floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from shared.physics.units import amplitude_to_db

FLOOR_DB = -200.0


def level_db(ratio: float) -> float:
    """An amplitude ratio in dB, not below FLOOR_DB."""
    return float(amplitude_to_db(ratio, FLOOR_DB))


def relative_l2(value: NDArray, reference: NDArray) -> float:
    """|value - reference| / |reference| over all elements; 0 where both are empty of signal, 1 where only one is."""
    scale = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(value - reference))
    return difference / scale if scale > 0.0 else float(difference > 0.0)


def peak_error(value: NDArray, reference: NDArray) -> float:
    """Largest difference over the reference's peak magnitude."""
    peak = float(np.abs(reference).max(initial=0.0))
    difference = float(np.abs(value - reference).max(initial=0.0))
    return difference / peak if peak > 0.0 else float(difference > 0.0)


def detections_changed(value: NDArray[np.bool_], reference: NDArray[np.bool_]) -> float:
    """Detections of one map [R, U] with none of the other in the 3 x 3 cells around, in percent of the reference's."""
    appeared = value & ~maximum_filter(reference, size=3)
    vanished = reference & ~maximum_filter(value, size=3)
    return 100.0 * float(appeared.sum() + vanished.sum()) / max(int(reference.sum()), 1)
