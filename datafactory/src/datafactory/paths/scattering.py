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

from math import comb, pi

import numpy as np

from datafactory.scenes.materials.table import Pattern
from shared.physics.compiled import inlined
from shared.physics.errors import InputError

LOBE_EXPONENT = 4
"""a of the backscattering pattern: lobes about 40 deg to either side."""
MIRROR_SHARE = 0.5
"""Lambda of the backscattering pattern. With 1, or with the directive pattern, there is hardly any backscatter off
normal incidence.
"""


def has_lobes(pattern: Pattern) -> bool:
    """Whether it is the backscattering pattern and not the Lambertian one.

    :raises InputError: neither
    """
    if pattern not in ("lambertian", "backscattering"):
        raise InputError("pattern", f"{pattern!r}", "lambertian or backscattering")
    return pattern == "backscattering"


@inlined()
def share_at(lobes, incidence, leaving, turned):
    """f of a pattern [1/sr], in kernels.

    :param lobes: of :func:`has_lobes`
    :param incidence, leaving: cosines to the normal of the way back along the arrival, and of the departure
    :param turned: cosine between arrival and departure
    """
    if not lobes:
        return abs(leaving) / np.pi
    towards_mirror = turned + 2.0 * incidence * leaving
    one, other = _lobe(towards_mirror), _lobe(-turned)
    return (MIRROR_SHARE * one + (1.0 - MIRROR_SHARE) * other) / _lobe_integral(abs(incidence))


@inlined()
def _lobe(cosine):
    return (0.5 * (1.0 + cosine)) ** LOBE_EXPONENT


_U = [comb(LOBE_EXPONENT, j) * 2.0 * pi / (j + 1) for j in range(LOBE_EXPONENT + 1)]
"""binomial(a, j) 2 pi / (j + 1): the terms of F for even j, for odd j their factors."""
_EVEN, _ODD = sum(_U[::2]), tuple(_U[1::2])
_SERIES = tuple(float(comb(2 * w, w)) for w in range(len(_ODD)))


@inlined()
def _lobe_integral(incidence_cosine):
    """Integral of a lobe over the half space in front, F of the module."""
    half_sine_squared = 0.25 * (1.0 - incidence_cosine * incidence_cosine)
    total, series, power = _EVEN, 0.0, 1.0
    for w in range(len(_ODD)):
        series += _SERIES[w] * power
        total += _ODD[w] * incidence_cosine * series
        power *= half_sine_squared
    return total / 2.0**LOBE_EXPONENT
