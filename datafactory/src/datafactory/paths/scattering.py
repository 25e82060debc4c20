"""What a rough surface scatters: the patterns of the effective-roughness model, and a phase that is the surface's own.

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

Sionna's diffuse paths have the phase of geometry alone. A real surface, rough on the scale of the wavelength, adds a
phase to every patch, the same from every position. The phase is therefore a hash of the object and of the cell in the
object's own coordinates, and does not depend on the ray's number. Rays that hit one cell share it. The sum over a
resolution cell becomes fully developed speckle, whose mean power is the sum of the paths' powers (Goodman, Speckle
Phenomena in Optics, section 2.1).
"""

from __future__ import annotations

from math import comb, pi

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.materials.table import Pattern
from shared.physics.compiled import inlined
from shared.physics.vectors import Index, Real

LOBE_EXPONENT = 4
"""a of the backscattering pattern: lobes about 40 deg to either side."""
MIRROR_SHARE = 0.5
"""Lambda of the backscattering pattern. With 1, or with the directive pattern, there is hardly any backscatter off
normal incidence.
"""


SURFACE_CELL_M = 0.05
"""About half the input array's aperture, the correlation length of a real surface's speckle at the sensor (Goodman,
section 4.3): a sensor that moves by it receives independent speckle.
"""
OFF_THE_GRID = 1.0 / 3.0
"""Shift of the cells: a plane at a whole number of them, as the ground at z = 0 is, would lie on their very border, and
rounding would draw its phases anew in every frame.
"""


def has_lobes(pattern: Pattern) -> bool:
    """Whether it is the backscattering pattern and not the Lambertian one."""
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


def surface_phase(position: Real, object_index: Index) -> Real:
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
