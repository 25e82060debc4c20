"""What a method draws where there is nothing: false alarms in frames of noise alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from shared.physics.errors import InputError
from trainer.estimators.array import LineArray


def noise_level(array: LineArray, noise_power: float, probability: float) -> float:
    """Magnitude that delay-and-sum of noise exceeds at any one angle with this probability [sqrt(W)].

    |I|^2 of noise is exponential of mean sigma^2 / C, so that the level is sqrt(-ln(probability) sigma^2 / C).

    :raises InputError: a probability not between 0 and 1
    """
    if not 0.0 < probability < 1.0:
        raise InputError("noise level", f"probability = {probability!r}", "a number between 0 and 1")
    return float(np.sqrt(-np.log(probability) * noise_power / array.channels))


def false_alarms(image: NDArray[np.floating], level: float) -> int:
    """Local maxima above ``level`` [sqrt(W)] in the rows of an image [R, U] of noise alone; a plateau is one.

    Delay-and-sum has sqrt(-ln p) beta Delta u / sqrt(pi) p of them in a row, at the level of probability p << 1 (Rice
    1944; beta = k std(p_c), Delta u the axis).
    """
    return sum(len(find_peaks(row, height=level)[0]) for row in image)
