"""GOSPA, a distance between sets of points that counts what is misplaced, missed and invented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from shared.physics.errors import InputError


@dataclass(frozen=True)
class Gospa:
    """A GOSPA distance and its parts: distance^p = localisation + missed + false.

    :param distance: in the points' unit
    :param localisation: sum of d^p over the assigned pairs
    :param missed: c^p / 2 for each true point without a partner
    :param false: c^p / 2 for each estimated point without a partner
    :param assigned: number of pairs
    """

    distance: float
    localisation: float
    missed: float
    false: float
    assigned: int


def gospa(estimated: NDArray[np.floating], true: NDArray[np.floating], cutoff: float, exponent: float = 2.0) -> Gospa:
    """Generalised optimal sub-pattern assignment with alpha = 2.

        d^p = min over assignments of  sum d(x, y)^p over its pairs + c^p / 2 (points left over in both sets)

    Rahmathullah, Garcia-Fernandez and Svensson, "Generalized optimal sub-pattern assignment metric", FUSION 2017,
    prop. 1. Pairs at the distance c or more cost as much apart as together and are left apart.

    :param estimated: [n, dimensions] positions
    :param true: [m, dimensions] positions
    :param cutoff: c, in the points' unit
    :param exponent: p
    :raises InputError: c not positive, p below 1, points of different dimensions or not finite
    """
    if not (np.isfinite(cutoff) and cutoff > 0.0 and np.isfinite(exponent) and exponent >= 1.0):
        raise InputError(
            "gospa", f"cutoff = {cutoff!r}, exponent = {exponent!r}", "a positive cutoff and an exponent from 1"
        )
    if np.ndim(estimated) != 2 or np.ndim(true) != 2 or np.shape(estimated)[1] != np.shape(true)[1]:
        shapes = f"points of shapes {np.shape(estimated)} and {np.shape(true)}"
        raise InputError("gospa", shapes, "[n, dimensions] and [m, dimensions]")
    if not (np.isfinite(estimated).all() and np.isfinite(true).all()):
        raise InputError("gospa", "points that are not finite", "finite positions")
    # In units of c, so that powers of large or small units stay in range.
    distance = cdist(estimated, true) / cutoff
    first, second = linear_sum_assignment(np.minimum(distance, 1.0) ** exponent)
    pairs = distance[first, second]
    kept = pairs < 1.0
    assigned = int(kept.sum())
    localisation = float(np.sum(pairs[kept] ** exponent))
    missed, false = 0.5 * (len(true) - assigned), 0.5 * (len(estimated) - assigned)
    power = cutoff**exponent
    root = cutoff * (localisation + missed + false) ** (1.0 / exponent)
    return Gospa(root, power * localisation, power * missed, power * false, assigned)
