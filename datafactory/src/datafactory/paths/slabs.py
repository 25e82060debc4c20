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

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from datafactory.paths.wave_steps import passed_fields, reflected_fields
from datafactory.scenes.materials.reflectivity import complex_permittivity
from datafactory.scenes.materials.table import Material
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor
from shared.physics.units import SPEED_OF_LIGHT, amplitude_to_db
from shared.physics.vectors import Complex, Index, Mask, Real, dots

OPAQUE_DB = -60.0
"""Transmission out and back below which what surfaces scatter behind a slab is not asked for: 30 dB under the default
error budget. A wall of 0.2 m of marble has -71 dB."""
LEAST_COSINE = 1e-9
"""Of an angle of incidence: a face seen edge on is seen almost so."""


class Slabs:
    """The slabs of a scene's meshes at one frequency: what n waves meet at the meshes of the numbers ``mesh`` [n].

    :param materials: of each mesh, M of them; :param frequency_hz: [Hz]
    """

    def __init__(self, materials: Sequence[Material], frequency_hz: float) -> None:
        self.materials, self.frequency_hz = tuple(materials), frequency_hz
        self.wavelength_m = SPEED_OF_LIGHT / frequency_hz
        values = [(slab.relative_permittivity, slab.conductivity_s_per_m) for slab in materials]
        self._eta = np.array([complex_permittivity(*value, frequency_hz) for value in values], dtype=np.complex128)
        self._thickness_m = np.array([slab.thickness_m for slab in materials], dtype=np.float64)
        self._wavelengths = self._thickness_m * frequency_hz / SPEED_OF_LIGHT
        self.scattering = np.array([slab.scattering_coefficient for slab in materials], dtype=np.float64)
        """[M] S."""

    def reflection(self, mesh: Index, cosine: Real) -> tuple[Complex, Complex]:
        """R [n], TE and TM, at the front faces.

        :param cosine: [n] of the angle of incidence, above 0
        """
        return _reflection(self._eta, self._wavelengths, mesh, np.ascontiguousarray(cosine))

    def transmission(self, mesh: Index, cosine: Real) -> tuple[Complex, Complex]:
        """T [n], TE and TM, over that of the air in the slabs' place: times exp(+j k d cos theta)."""
        te, tm = _transmission(self._eta, self._wavelengths, mesh, np.ascontiguousarray(cosine))
        air = np.exp((2j * np.pi * self.frequency_hz / SPEED_OF_LIGHT * self._thickness_m)[mesh] * cosine)
        return te * air, tm * air

    def unscattered(self, mesh: Index) -> Real:
        """[n] sqrt(1 - S^2), what scattering leaves of a mirror."""
        return np.sqrt(1.0 - self.scattering**2)[mesh]

    def mirrored(self, mesh: Index, direction: Real, normal: Real, field: Complex) -> tuple[Real, Complex]:
        """Directions [n, 3] and fields [n, 3] of the waves that slabs send on: sqrt(1 - S^2) R e.

        :param direction: [n, 3] unit; :param normal: [n, 3] unit, on either side; :param field: [n, 3] across
            ``direction``
        """
        cosine = np.clip(np.abs(dots(direction, normal)), LEAST_COSINE, 1.0)
        onward, reflected = reflected_fields(direction, normal, field, *self.reflection(mesh, cosine))
        return onward, self.unscattered(mesh)[:, None] * reflected

    def passed(self, mesh: Index, direction: Real, normal: Real, field: Complex) -> Complex:
        """The fields [n, 3] behind slabs; arguments as in :meth:`mirrored`, either sense of a direction."""
        cosine = np.clip(np.abs(dots(direction, normal)), 1e-6, 1.0)
        return passed_fields(direction, normal, field, *self.transmission(mesh, cosine))

    @cached_property
    def lets_through(self) -> Mask:
        """[M] whether surfaces behind the slabs are heard. Absorption is least at normal incidence."""
        count = len(self.materials)
        te, _ = _transmission(self._eta, self._wavelengths, np.arange(count), np.ones(count))
        return np.asarray(amplitude_to_db(te**2) > OPAQUE_DB)

    @cached_property
    def most_passed(self) -> Real:
        """[M] the largest |T|, over the angles of incidence."""
        cosine = np.linspace(0.02, 1.0, 99)
        every = [np.abs(self.transmission(np.full(99, m), cosine)).max() for m in range(len(self.materials))]
        return np.array(every, dtype=np.float64)


@compiled(error_model="numpy")
def _transmission(eta, wavelengths, mesh, cosine):
    """T [n], TE and TM, of slabs of permittivities ``eta`` [M] and thicknesses ``wavelengths`` [M]."""
    te, tm = np.empty(len(cosine), dtype=np.complex128), np.empty(len(cosine), dtype=np.complex128)
    for k in range(len(cosine)):
        through, of_te, of_tm = _terms(eta[mesh[k]], wavelengths[mesh[k]], cosine[k])
        te[k] = _over((1.0 - of_te * of_te) * through, 1.0 - of_te * through * of_te * through)
        tm[k] = _over((1.0 - of_tm * of_tm) * through, 1.0 - of_tm * through * of_tm * through)
    return te, tm


@compiled(error_model="numpy")
def _reflection(eta, wavelengths, mesh, cosine):
    """R [n], TE and TM; arguments as in :func:`_transmission`."""
    te, tm = np.empty(len(cosine), dtype=np.complex128), np.empty(len(cosine), dtype=np.complex128)
    for k in range(len(cosine)):
        through, of_te, of_tm = _terms(eta[mesh[k]], wavelengths[mesh[k]], cosine[k])
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
