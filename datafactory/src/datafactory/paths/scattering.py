"""What a rough surface scatters: the patterns of the effective-roughness model.

A surface of scattering coefficient S takes S^2 |Gamma|^2 of the power that falls on it out of the mirror's direction
and spreads it over the half space in front, with the pattern f [1/sr] (Degli-Esposti et al. 2007,
doi 10.1109/TAP.2006.888422), whose integral over that half space is 1:

    lambertian       f = cos(theta_s) / pi
    backscattering   f = (Lambda ((1 + cos(psi_r)) / 2)^a + (1 - Lambda) ((1 + cos(psi_i)) / 2)^a) / F

with psi_r the angle from the mirror's direction, psi_i that from the direction back, and F the pattern's own integral.
With u_j the integral of cos(psi)^j over the half space,

    F = 2^-a sum_j binomial(a, j) u_j,   u_j = 2 pi / (j + 1) times 1 for even j,
                                         times cos(theta_i) sum_{w=0}^{(j-1)/2} binomial(2w, w) (sin(theta_i) / 2)^(2w)
                                         for odd j;

it is the same for both lobes where they have the same exponent, as here.
"""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.materials.table import Pattern
from shared.physics.errors import InputError
from shared.physics.vectors import dots

Real = NDArray[np.float64]

LOBE_EXPONENT = 4
"""a of the backscattering pattern: lobes about 40 deg to either side."""
MIRROR_SHARE = 0.5
"""Lambda of the backscattering pattern. With 1, or with the directive pattern, there is hardly any backscatter off
normal incidence.
"""


def scattered_share(pattern: Pattern, arrival: Real, departure: Real, normal: Real) -> Real:
    """[K] f of the pattern [1/sr].

    :param arrival: [K, 3] unit directions in which the wave arrives, towards the surface
    :param departure: [K, 3] unit directions in which it leaves, on the side of ``normal``
    :param normal: [K, 3] unit normals on the side on which the wave arrives
    :raises InputError: a pattern that is not in the table of the module
    """
    incidence = -dots(arrival, normal)
    if pattern == "lambertian":
        return np.abs(dots(departure, normal)) / np.pi
    if pattern == "backscattering":
        mirrored = arrival + 2.0 * incidence[:, None] * normal
        towards_mirror = dots(mirrored, departure)
        back = -dots(arrival, departure)
        lobes = MIRROR_SHARE * _lobe(towards_mirror) + (1.0 - MIRROR_SHARE) * _lobe(back)
        return lobes / _lobe_integral(np.abs(incidence))
    raise InputError("pattern", f"{pattern!r}", "lambertian or backscattering")


def _lobe(cosine: Real) -> Real:
    return (0.5 * (1.0 + cosine)) ** LOBE_EXPONENT


def _lobe_integral(incidence_cosine: Real) -> Real:
    """[K] integral of a lobe over the half space in front, F of the module."""
    half_sine_squared = 0.25 * (1.0 - incidence_cosine**2)
    total = np.zeros_like(incidence_cosine)
    series = np.zeros_like(incidence_cosine)
    for power in range(LOBE_EXPONENT + 1):
        share: Real | float = 1.0
        if power % 2:
            w = (power - 1) // 2
            series = series + comb(2 * w, w) * half_sine_squared**w
            share = incidence_cosine * series
        total += comb(LOBE_EXPONENT, power) * 2.0 * np.pi / (power + 1) * share
    return total / 2.0**LOBE_EXPONENT
