"""Slabs: what one layer of a material in air lets through and sends back.

ITU-R P.2040-4 eq. (43), (44), multiple reflections inside included: with eta the complex relative permittivity, theta
the angle of incidence, d the thickness, k = 2 pi / lambda,

    q = k d sqrt(eta - sin^2 theta),   T = (1 - r^2) exp(-jq) / (1 - r^2 exp(-2jq)),
    R = r (1 - exp(-2jq)) / (1 - r^2 exp(-2jq)),

and r the Fresnel coefficients of its surface, eq. (37). T is the field behind the slab over the field in front of it,
at points opposite each other: a pane of air has exp(-j k d cos theta). Valid for slabs wider than the beam's Fresnel
zone and for a pulse longer than the echoes within (d |sqrt(eta)| well below the range resolution of 0.15 m; thicker
walls absorb them).

Time convention exp(+j omega t); amplitudes for the path table are the conjugates.

The kernels write root, exponential and quotient out in real numbers: the compiler vectorises these, and calls a library
for the complex ones, at six times the price.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datafactory.scenes.materials.reflectivity import complex_permittivity
from datafactory.scenes.materials.table import Material
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor
from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT, amplitude_to_db

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

OPAQUE_DB = -60.0
"""Transmission out and back below which what surfaces scatter behind a slab is not asked for: 30 dB under the default
error budget. A wall of 0.2 m of marble has -71 dB."""


def slab_transmission(
    relative_permittivity: float,
    conductivity_s_per_m: float,
    thickness_m: float,
    frequency_hz: float,
    incidence_cosine: ArrayLike,
) -> tuple[Complex, Complex]:
    """T of a slab for the electric field across (TE) and in (TM) the plane of incidence.

    :param relative_permittivity: eps' > 0; :param conductivity_s_per_m: at least 0; :param thickness_m: at least 0
    :param incidence_cosine: [...] cosine of the angle from the normal, above 0 and at most 1
    :return: TE [...] and TM [...]; 0 where the slab absorbs everything
    :raises InputError: a value outside these bounds
    """
    values = relative_permittivity, conductivity_s_per_m, thickness_m, frequency_hz, incidence_cosine
    return _checked(_transmission, *values)


def slab_reflection(
    relative_permittivity: float,
    conductivity_s_per_m: float,
    thickness_m: float,
    frequency_hz: float,
    incidence_cosine: ArrayLike,
) -> tuple[Complex, Complex]:
    """R of a slab, TE [...] and TM [...], at its front face; arguments as in :func:`slab_transmission`.

    TE is the sign of the electric field, TM that of the magnetic one: a perfect conductor has -1 and +1.
    """
    values = relative_permittivity, conductivity_s_per_m, thickness_m, frequency_hz, incidence_cosine
    return _checked(_reflection, *values)


def lets_through(slab: Material, frequency_hz: float) -> bool:
    """Whether surfaces behind a slab are heard. Absorption is least at normal incidence."""
    te, _ = slab_transmission(
        slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, frequency_hz, np.ones(1)
    )
    return bool(amplitude_to_db(te[0] ** 2) > OPAQUE_DB)


def transmission_over_air(material: Material, frequency_hz: float, cosine: Real) -> tuple[Complex, Complex]:
    """T [K], TE and TM, over that of the air in the slab's place: times exp(+j k d cos theta).

    :param cosine: [K] of the angle from the normal, above 0 and at most 1
    """
    te, tm = slab_transmission(
        material.relative_permittivity, material.conductivity_s_per_m, material.thickness_m, frequency_hz, cosine
    )
    air = np.exp(2j * np.pi * frequency_hz / SPEED_OF_LIGHT * material.thickness_m * cosine)
    return te * air, tm * air


def _checked(
    kernel, permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, incidence: ArrayLike
) -> tuple[Complex, Complex]:
    cosine = np.asarray(incidence, dtype=np.float64)
    for name, bad, value, expected in (
        ("relative_permittivity", not permittivity > 0.0, permittivity, "above 0"),
        ("conductivity", not conductivity >= 0.0, conductivity, "at least 0 S/m"),
        ("thickness", not thickness_m >= 0.0, thickness_m, "at least 0 m"),
        ("frequency", not frequency_hz > 0.0, frequency_hz, "above 0 Hz"),
        ("incidence_cosine", not np.all((cosine > 0.0) & (cosine <= 1.0)), incidence, "above 0 and at most 1"),
    ):
        if bad:
            raise InputError(f"slab {name}", f"{value!r}", expected)
    eta = complex_permittivity(permittivity, conductivity, frequency_hz)
    thickness = float(thickness_m * frequency_hz / SPEED_OF_LIGHT)
    te, tm = kernel(eta, thickness, np.ascontiguousarray(cosine).reshape(-1))
    return te.reshape(cosine.shape), tm.reshape(cosine.shape)


@compiled(error_model="numpy")
def _transmission(eta, wavelengths, cosine):
    te, tm = np.empty(len(cosine), dtype=np.complex128), np.empty(len(cosine), dtype=np.complex128)
    for k in range(len(cosine)):
        through, of_te, of_tm = _terms(eta, wavelengths, cosine[k])
        te[k] = _over((1.0 - of_te * of_te) * through, 1.0 - of_te * through * of_te * through)
        tm[k] = _over((1.0 - of_tm * of_tm) * through, 1.0 - of_tm * through * of_tm * through)
    return te, tm


@compiled(error_model="numpy")
def _reflection(eta, wavelengths, cosine):
    te, tm = np.empty(len(cosine), dtype=np.complex128), np.empty(len(cosine), dtype=np.complex128)
    for k in range(len(cosine)):
        through, of_te, of_tm = _terms(eta, wavelengths, cosine[k])
        twice = through * through
        te[k] = _over(of_te * (1.0 - twice), 1.0 - of_te * of_te * twice)
        tm[k] = _over(of_tm * (1.0 - twice), 1.0 - of_tm * of_tm * twice)
    return te, tm


@inlined(error_model="numpy")
def _terms(eta, wavelengths, cosine):
    """exp(-jq) and the surface's Fresnel coefficients TE, TM."""
    # eta - 1 + cos^2 is eta - sin^2 without the cancellation that a slab of air has at grazing incidence.
    real, imaginary = eta.real - 1.0 + cosine * cosine, eta.imag
    larger = np.sqrt(0.5 * (np.sqrt(real * real + imaginary * imaginary) + abs(real)))
    smaller = 0.5 * abs(imaginary) / larger if larger > 0.0 else 0.0
    # The root of negative imaginary part: exp(-jq) decays, for eta < sin^2 too.
    phase, decay = (larger, smaller) if real >= 0.0 else (smaller, larger)
    root = complex(phase, -decay)
    te = _over(cosine - root, cosine + root)
    tm = _over(eta * cosine - root, eta * cosine + root)
    along, across = phasor(-wavelengths * phase)
    left = np.exp(-2.0 * np.pi * wavelengths * decay)
    return complex(left * along, left * across), te, tm


@inlined(error_model="numpy")
def _over(one, other):
    """``one / other`` without the branches against overflow, which keep a loop from being vectorised."""
    square = 1.0 / (other.real * other.real + other.imag * other.imag)
    return complex(
        (one.real * other.real + one.imag * other.imag) * square,
        (one.imag * other.real - one.real * other.imag) * square,
    )
