"""Where rays are sent: directions over the radar's field of view, denser towards the horizon.

A full-sphere lattice sends most of its rays to the sky and to the road under the bumper. The lattice here covers the
front half space, uniform in azimuth; the sine of elevation z has the density

    p(z) = 1 / (2 asinh(1 / z_0) sqrt(z_0^2 + z^2)),   -1 <= z <= 1,

so that log-distances on the ground get equal shares, down to the grazing angle z_0. Each direction then stands for a
solid angle of 1 / (N p), with p(azimuth, z) = p(z) / pi per steradian, instead of the full lattice's 4 pi / N, and
diffuse amplitudes are scaled by the square root of that ratio: their expected power is unchanged.

The points come from the Kronecker sequence of the golden ratio that the Fibonacci lattice is made of, rotated by a
random offset per frame (Cranley-Patterson), so that neighbouring frames do not share artefacts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HORIZON = 0.01
"""z_0: at a sensor height of 0.5 m the ground at 50 m."""
GOLDEN_RATIO = (1.0 + np.sqrt(5.0)) / 2.0


@dataclass(frozen=True)
class RayFan:
    """Directions of the first segment, in the radar frame.

    :param count: number of rays
    :param offset: [2] shift of the lattice in its unit square, per frame
    :param horizon: z_0 of the density
    """

    count: int
    offset: tuple[float, float] = (0.0, 0.0)
    horizon: float = HORIZON

    def unit_square(self) -> NDArray[np.float64]:
        """[count, 2] the points that Mitsuba's ``square_to_uniform_sphere`` turns into these directions.

        That map takes (a, b) to azimuth 2 pi a and z = 1 - 2 b.
        """
        index = np.arange(self.count)
        across = (index / GOLDEN_RATIO + self.offset[0]) % 1.0
        up = ((index + 0.5) / self.count + self.offset[1]) % 1.0
        azimuth = np.pi * (across - 0.5)
        z = self.horizon * np.sinh((2.0 * up - 1.0) * np.arcsinh(1.0 / self.horizon))
        return np.stack([(azimuth / (2.0 * np.pi)) % 1.0, np.clip(0.5 * (1.0 - z), 0.0, 1.0)], axis=1)

    def solid_angle_ratio(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """[K] solid angle that a ray in these directions [K, 3] stands for, relative to the full lattice's 4 pi /
        count.
        """
        z = directions[:, 2] / np.linalg.norm(directions, axis=1)
        density = 1.0 / (2.0 * np.arcsinh(1.0 / self.horizon) * np.sqrt(self.horizon**2 + z**2)) / np.pi
        return 1.0 / (4.0 * np.pi * density)
