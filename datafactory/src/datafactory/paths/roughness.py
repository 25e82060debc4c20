"""The random phase of a rough surface, fixed to the surface.

Sionna's diffuse paths have the phase of geometry alone. A real surface, rough on the scale of the wavelength, adds a
phase to every patch, the same from every position. The phase is therefore a hash of the object and of the cell in the
object's own coordinates, and does not depend on the ray's number. Rays that hit one cell share it. The sum over a
resolution cell becomes fully developed speckle, whose mean power is the sum of the paths' powers (Goodman, Speckle
Phenomena in Optics, section 2.1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SURFACE_CELL_M = 0.05
"""About half the input array's aperture, the correlation length of a real surface's speckle at the sensor (Goodman,
section 4.3): a sensor that moves by it receives independent speckle.
"""

OFF_THE_GRID = 1.0 / 3.0
"""Shift of the cells: a plane at a whole number of them, as the ground at z = 0 is, would lie on their very border, and
rounding would draw its phases anew in every frame.
"""


def surface_phase(position: NDArray[np.float64], object_index: NDArray[np.int64]) -> NDArray[np.float64]:
    """[n] phases in [0, 2 pi) of surface points.

    :param position: [n, 3] in the object's own coordinates, i.e. in the world at time 0 [m]
    :param object_index: [n] which object
    """
    cell = np.floor(position / SURFACE_CELL_M + OFF_THE_GRID).astype(np.int64).view(np.uint64)
    key = np.asarray(object_index, dtype=np.int64).view(np.uint64)
    for axis in range(3):
        key = _split_mix_64(key ^ cell[:, axis])
    return 2.0 * np.pi * 2.0**-53 * (key >> np.uint64(11)).astype(np.float64)


def _split_mix_64(key: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """One step of SplitMix64 (Steele, Lea and Flood 2014): every input bit reaches every output bit."""
    key = key + np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))
