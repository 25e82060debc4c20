"""Parts of a target that move against its body: what a model with options adds to its rigid echo points.

A frame's paths have constant velocities (:mod:`datafactory.paths.table`). A part's are those at the frame's start. Its
acceleration a then makes an error of a T^2 / 2 in place and a T in velocity by the end of a frame of T seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """How a target moves, for models whose parts move too.

    :param forward_mps: speed along the model's x [m/s]; negative where it goes backwards
    :param time_s: since the scene's time 0 [s]
    :param seed: of what is random in a target: where in its cycle it is at time 0
    """

    forward_mps: float = 0.0
    time_s: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class MovingParts:
    """N echo points in the target's frame.

    :param position: [N, 3] [m]
    :param velocity: [N, 3] relative to the target's origin [m/s]
    :param rcs_m2: [N] cross sections towards the radar [m^2]
    """

    position: Real
    velocity: Real
    rcs_m2: Real

    @staticmethod
    def none() -> MovingParts:
        return MovingParts(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
