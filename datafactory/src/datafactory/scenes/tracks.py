"""Tracks: poses with times, one after the other, as values and as curves through them.

Between two rows a track is a cubic in each coordinate (Hermite form), and its velocity is that cubic's derivative.
Where no velocities are given, the slopes at the rows are those of the modified Akima method (H. Akima, "A new method
of interpolation and smooth curve fitting", J. ACM 17(4), 1970, with the weights of ``scipy``'s "makima"): it does not
swing where the sensor stops. The attitude turns at a constant rate from row to row, the shorter way (K. Shoemake,
"Animating rotation with quaternion curves", SIGGRAPH 1985).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from datafactory.scenes.motion import triple
from datafactory.scenes.poses import Pose
from shared.physics.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

Real = NDArray[np.float64]

LEAST_RATE_HZ, MOST_RATE_HZ = 1e-3, 1e5
MOST_FRAMES = 1_000_000
"""Of one track: more than a month at 0.3 Hz is a mistyped rate."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Where a sensor is at any time, by its rows.

    :param time_s: [n] rising, n at least 2
    :param position: [n, 3] world [m]
    :param angles_deg: [n, 3] yaw, pitch, roll, see :class:`datafactory.scenes.poses.Pose`
    :param velocity: [n, 3] world [m/s]; None where it follows from the positions
    """

    time_s: Real
    position: Real
    angles_deg: Real
    velocity: Real | None = None

    def _places(self) -> CubicHermiteSpline:
        from scipy.interpolate import Akima1DInterpolator, CubicHermiteSpline

        slopes = self.velocity
        if slopes is None and len(self.time_s) > 2:
            slopes = Akima1DInterpolator(self.time_s, self.position, method="makima").derivative()(self.time_s)
        elif slopes is None:
            slopes = np.diff(self.position, axis=0).repeat(2, axis=0) / np.diff(self.time_s)
        return CubicHermiteSpline(self.time_s, self.position, slopes)

    def rows(self) -> tuple[Pose, ...]:
        """One pose a row, as it was given."""
        velocity = self._places()(self.time_s, 1)
        return tuple(map(pose_of, self.time_s, self.position, self.angles_deg, velocity))

    def at(self, time_s: Real) -> tuple[Pose, ...]:
        """One pose for each time [s] between the first and the last row."""
        places = self._places()
        turns = Slerp(self.time_s, Rotation.from_euler("ZYX", self.angles_deg, degrees=True))
        angles = turns(time_s).as_euler("ZYX", degrees=True, suppress_warnings=True)
        return tuple(map(pose_of, time_s, places(time_s), angles, places(time_s, 1)))

    def resampled(self, rate_hz: float) -> tuple[Pose, ...]:
        """One pose each 1 / rate from the first row on, as far as the last.

        :raises InputError: a rate out of bounds, or one that gives more than a million poses
        """
        require_rate(rate_hz)
        lasts_s = float(self.time_s[-1] - self.time_s[0])
        # The last row is met in spite of the rounding of a sum of decimals.
        count = math.floor(lasts_s * rate_hz + 1e-6) + 1
        if count > MOST_FRAMES:
            raise InputError("--frame-rate", f"{rate_hz:g} Hz over {lasts_s:g} s is {count} frames", f"{MOST_FRAMES}")
        return self.at(np.minimum(self.time_s[0] + np.arange(count) / rate_hz, self.time_s[-1]))


def require_rate(rate_hz: float) -> None:
    """:raises InputError: no rate of frames"""
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise InputError("--frame-rate", f"{rate_hz!r}", f"{LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz")


def pose_of(time_s: float, position: Real, angles_deg: Real, velocity: Real) -> Pose:
    """A pose of plain numbers."""
    return Pose(triple(position), *triple(angles_deg), triple(velocity), float(time_s))


def nearest_m(one: Sequence[Pose], other: Sequence[Pose]) -> float:
    """Smallest distance between a pose of one track and one of another [m]."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree([pose.position for pose in one]).query([pose.position for pose in other])
    return float(distance.min())
