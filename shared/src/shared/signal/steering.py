"""The phases of plane waves over a line of virtual elements: one sign and one wavelength for all who image or estimate.

By eq. (1) and (2) the echo of a target at u = sin(azimuth) has the phase -k u p over the virtual elements at
p = y_tx + y_rx, k = 2 pi / lambda of mid-sweep. These echoes of unit amplitude are the manifold a(u). Who looks for an
echo multiplies by the conjugate, exp(+j k u p), so that images peak at +u.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex128, Float
from numpy.typing import ArrayLike


def manifold(
    positions_m: Float[np.ndarray, " channels"], wavelength_m: float, u: ArrayLike
) -> Complex128[np.ndarray, "channels ..."]:
    """[C, *u.shape] a(u) = exp(-j k u p), echoes of unit amplitude from the directions u.

    Valid from about 5 m for the input array of 94 mm: nearer than that the wave front is curved.

    :param positions_m: [C] y_tx + y_rx of each virtual element [m]
    :param wavelength_m: at mid-sweep [m]
    """
    wavenumber = 2.0 * np.pi / wavelength_m
    return np.exp(-1j * wavenumber * np.multiply.outer(positions_m, np.asarray(u, dtype=np.float64)))
