"""Fresnel reflectivity of a half-space, and the scattering coefficient that gives a stated backscatter.

Half-spaces only: the interference within a slab of finite thickness is the tracer's part. Time convention
exp(+j omega t), so a lossy permittivity is eps' - j sigma / (omega eps0).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.physics.units import db_to_power

VACUUM_PERMITTIVITY = 8.854_187_8128e-12
"""Electric constant [F/m] (CODATA 2018)."""

Polarization = Literal["te", "tm"]


def complex_permittivity(relative_permittivity: float, conductivity_s_per_m: float, frequency_hz: float) -> complex:
    """Relative permittivity eps' - j sigma / (2 pi f eps0), ITU-R P.2040-4."""
    return complex(relative_permittivity, -conductivity_s_per_m / (2.0 * math.pi * frequency_hz * VACUUM_PERMITTIVITY))


def fresnel_reflectivity(
    relative_permittivity: float,
    conductivity_s_per_m: float,
    frequency_hz: float,
    incidence_rad: ArrayLike,
    polarization: Polarization,
) -> NDArray[np.float64]:
    """Power reflectivity |Gamma|^2 of a plane half-space in air, for each angle of incidence.

    With eta the complex permittivity and theta the angle from the normal (ITU-R P.2040-4 eq. (37)):
    Gamma_TE = (cos - sqrt(eta - sin^2)) / (cos + sqrt(eta - sin^2)),
    Gamma_TM = (eta cos - sqrt(eta - sin^2)) / (eta cos + sqrt(eta - sin^2)). On a horizontal surface TE is a
    horizontally polarised wave and TM a vertically polarised one.

    :param incidence_rad: [...] angle from the normal [rad], 0 to pi/2
    :param polarization: ``"te"`` or ``"tm"``
    :return: [...] between 0 and 1
    """
    eta = complex_permittivity(relative_permittivity, conductivity_s_per_m, frequency_hz)
    theta = np.asarray(incidence_rad, dtype=np.float64)
    cosine = np.cos(theta)
    root = np.sqrt(eta - np.sin(theta) ** 2)
    leading = cosine if polarization == "te" else eta * cosine
    return np.abs((leading - root) / (leading + root)) ** 2


def lambertian_sigma0(
    scattering_coefficient: float, reflectivity: ArrayLike, incidence_rad: ArrayLike
) -> NDArray[np.float64]:
    """Monostatic radar cross section per unit area [m^2/m^2] of a Lambertian surface.

    The effective-roughness model (Degli-Esposti et al. 2007, doi 10.1109/TAP.2006.888422) scatters S^2 |Gamma|^2 of
    the intercepted power with pattern cos(theta_s) / pi. A facet dA intercepts cos(theta_i) dA, and sigma is 4 pi
    times the power per steradian over the power density, hence sigma0 = 4 S^2 |Gamma|^2 cos^2(theta). The tracer takes
    |Gamma|^2 at the actual angle and polarisation, and so must the caller. Far larger than a resolution cell, no
    shadowing.
    """
    return 4.0 * scattering_coefficient**2 * np.asarray(reflectivity) * np.cos(incidence_rad) ** 2


def largest_sigma0(
    grazing_deg: float, relative_permittivity: float, conductivity_s_per_m: float, frequency_hz: float
) -> float:
    """sigma0 [m^2/m^2] of a Lambertian half-space of S = 1 to a vertically polarised radar (TM over a road).

    :param grazing_deg: angle above the surface [deg], above 0 and at most 90
    """
    incidence = math.radians(90.0 - grazing_deg)
    reflectivity = fresnel_reflectivity(relative_permittivity, conductivity_s_per_m, frequency_hz, incidence, "tm")
    return float(lambertian_sigma0(1.0, reflectivity, incidence))


def scattering_coefficient_for_sigma0(
    sigma0_db: float,
    grazing_deg: float,
    relative_permittivity: float,
    conductivity_s_per_m: float,
    frequency_hz: float,
) -> float:
    """Scattering coefficient S with which a Lambertian half-space has the stated sigma0 at the stated grazing angle.

    The radar is vertically polarised (TM over a road).

    The inverse of :func:`lambertian_sigma0`, capped at S = 1 because the model cannot scatter more than it reflects.
    The match is exact at that one angle: elsewhere the model follows |Gamma|^2 sin^2(grazing). For asphalt set to
    -20 dB x sin(grazing) at 5 deg and vertical polarisation that is -3.4 dB off at 1 deg and -2 dB at 10 deg; at the
    Brewster angle (20 deg grazing) the model has a null that no road has.

    :param sigma0_db: radar cross section per unit area [dB relative to 1 m^2/m^2]
    :param grazing_deg: angle above the surface [deg], above 0 and at most 90
    """
    unit = largest_sigma0(grazing_deg, relative_permittivity, conductivity_s_per_m, frequency_hz)
    return min(1.0, math.sqrt(float(db_to_power(sigma0_db)) / unit))
