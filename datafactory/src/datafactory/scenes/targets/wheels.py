"""Rolling wheels: echo points on the rim, from rest at the ground to twice the vehicle's speed at the top.

A wheel of radius r that rolls without slip turns by v / r [rad/s]. A point on it at the angle alpha from the top,
forward, is at

    x = r sin(alpha),  z = r cos(alpha),   alpha = alpha_0 + v t / r,

about the hub. It moves along x at v (1 + cos(alpha)) over the ground: 0 where it touches the ground, 2 v at the top.
The mean is v (Chen, The Micro-Doppler Effect in Radar, 2nd ed., 2019, chapter 3, on rigid bodies that turn).

The points' angles are drawn once, from the target's seed, and stay: at any time it is the same wheel. The level is one
number for a wheel, an assumption: -10 dBsm for a car's (21 dB below a car's mean), a quarter of a cyclist's total for a
bicycle's.

Limits. A point's velocity is constant within a frame (:mod:`datafactory.scenes.targets.interface`), though it turns
by 26 deg in 10.3 ms at 14 m/s: docs/notes/targets.md says what that leaves out. The ``POINTS`` of a wheel stand 15
deg apart on average: the spectrum of all is filled as it should be, from 0 to 2 v, and its fine structure is not
right. Spokes and discs are left out, which fill the spectrum's middle. Of a car's wheels those on the side that the
radar sees echo; of a car seen from ahead or behind those of the nearer axle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.targets.interface import Motion, MovingParts

Real = NDArray[np.float64]

POINTS = 24
"""Echo points of a wheel."""


def rolling_wheels(
    hubs: Real, radius_m: float, rcs_m2: Real, motion: Motion, hidden_below_m: float = 0.0
) -> MovingParts:
    """The rims of wheels whose axles lie along y.

    :param hubs: [H, 3] places of the hubs in the vehicle's frame [m]
    :param rcs_m2: [H] cross section of each wheel, all of its points together [m^2]
    :param hidden_below_m: points lower than this over the foot of the wheel are silent, as behind a kerb [m]
    """
    start = np.random.default_rng(motion.seed).uniform(0.0, 2.0 * np.pi, (len(hubs), POINTS))
    angle = start + motion.forward_mps * motion.time_s / radius_m
    sine, cosine = np.sin(angle), np.cos(angle)
    zero = np.zeros_like(angle)
    offset = radius_m * np.stack([sine, zero, cosine], axis=2)
    velocity = motion.forward_mps * np.stack([cosine, zero, -sine], axis=2)
    level = np.where(radius_m * (1.0 + cosine) < hidden_below_m, 0.0, np.asarray(rcs_m2)[:, None] / POINTS)
    return MovingParts((hubs[:, None] + offset).reshape(-1, 3), velocity.reshape(-1, 3), level.reshape(-1))
