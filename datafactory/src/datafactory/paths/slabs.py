"""Slabs: what one layer of a material in air lets through and sends back, and the steps of waves that meet one.

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
for the complex ones, at six times the price. Each is given arrays of one layout, so that it is compiled once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

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

ON_ITS_PLANE = 1e-2
"""A point may move by this share of its distance onto its triangle's plane; by more where the plane is seen edge on,
and then the ray caster's own distance is kept.
"""
STEEP = 1e-6
"""Sine of an angle of incidence below which there is no plane of incidence; R_TE = -R_TM and T_TE = T_TM there, and any
will do.
"""


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
        return _reflection(self._eta, self._wavelengths, np.ascontiguousarray(mesh), np.ascontiguousarray(cosine))

    def transmission(self, mesh: Index, cosine: Real) -> tuple[Complex, Complex]:
        """T [n], TE and TM, over that of the air in the slabs' place: times exp(+j k d cos theta)."""
        te, tm = _transmission(self._eta, self._wavelengths, np.ascontiguousarray(mesh), np.ascontiguousarray(cosine))
        air = np.exp((2j * np.pi * self.frequency_hz / SPEED_OF_LIGHT * self._thickness_m)[mesh] * cosine)
        return te * air, tm * air

    def unscattered(self, mesh: Index) -> Real:
        """[n] sqrt(1 - S^2), what scattering leaves of a mirror."""
        return np.sqrt(1.0 - self.scattering**2)[mesh]

    def reflected(self, mesh: Index, direction: Real, normal: Real, field: Complex) -> tuple[Real, Complex]:
        """Directions [n, 3] and fields [n, 3] of the waves that smooth slabs send on.

        :param direction: [n, 3] unit; :param normal: [n, 3] unit, on either side; :param field: [n, 3] across
            ``direction``
        """
        return fields_beyond(direction, normal, field, *self.reflection(mesh, _cosine(direction, normal)), True)

    def passed(self, mesh: Index, direction: Real, normal: Real, field: Complex) -> Complex:
        """The fields [n, 3] behind slabs; arguments as in :meth:`reflected`, either sense of a direction."""
        return fields_beyond(direction, normal, field, *self.transmission(mesh, _cosine(direction, normal)), False)[1]

    def reflectivity(self, mesh: Index, direction: Real, normal: Real, field: Complex) -> Real:
        """[n] |R e| / |e|; arguments as in :meth:`reflected`."""
        return _reflectivity(direction, normal, field, *self.reflection(mesh, _cosine(direction, normal)))

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


@compiled()
def onto_planes(index, start, lifted, direction, distance, triangle, normals, heights):
    """Where n of m rays meet triangles.

    :param index: [n] of the rays that do
    :param start: [m, 3] [m]; :param lifted: [m, 3] where the ray caster began [m]; :param direction: [m, 3] unit
    :param distance: [m] along the ray from there as the ray caster has it, to float32 [m]
    :param triangle: [n] that was met
    :param normals: [T, 3] unit, of all triangles; :param heights: [T] of their planes over the origin [m]
    :return: points [n, 3], normals [n, 3] on the side of arrival, cosines [n] of incidence, 0 where the triangle has no
        area, and distances [n]
    """
    count = len(index)
    point, normal, cosine, length = np.empty((count, 3)), np.empty((count, 3)), np.zeros(count), np.empty(count)
    for k in range(count):
        ray, which = index[k], triangle[k]
        slope, height, cast = 0.0, heights[which], heights[which]
        for i in range(3):
            slope += normals[which, i] * direction[ray, i]
            height -= normals[which, i] * start[ray, i]
            cast -= normals[which, i] * lifted[ray, i]
        along = distance[ray]
        if slope != 0.0 and abs(cast / slope - along) <= ON_ITS_PLANE * along:
            along = height / slope
        side = -1.0 if slope > 0.0 else 1.0
        square = 0.0
        for i in range(3):
            point[k, i] = start[ray, i] + along * direction[ray, i]
            normal[k, i] = side * normals[which, i]
            square += normals[which, i] ** 2
        if square > 0.5:
            cosine[k] = min(max(abs(slope), 1e-9), 1.0)
        length[k] = along
    return point, normal, cosine, length


def _cosine(direction: Real, normal: Real) -> Real:
    """[n] of the angles of incidence."""
    return np.clip(np.abs(dots(direction, normal)), LEAST_COSINE, 1.0)


@compiled()
def fields_beyond(direction, normal, field, te, tm, mirrored):
    """Directions [n, 3] and fields [n, 3] of waves beyond planes.

    With n the normal, k and k' the directions before and after, the field across the plane of incidence, along
    s = k x n, is multiplied with R_TE or T_TE, and that along k x s comes back along k' x s, with R_TM or T_TM.

    :param direction: [n, 3] unit; :param normal: [n, 3] unit; :param field: [n, 3] complex, across ``direction``
    :param te, tm: [n] R or T of the electric field across and in the plane of incidence
    :param mirrored: whether the waves are; else they keep their directions
    """
    count = len(direction)
    onward, beyond = np.empty((count, 3)), np.empty((count, 3), dtype=np.complex128)
    s, p, q = np.empty(3), np.empty(3), np.empty(3)
    for k in range(count):
        d, n = direction[k], normal[k]
        turned = 2.0 * (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]) if mirrored else 0.0
        for i in range(3):
            onward[k, i] = d[i] - turned * n[i]
        across, within = _parts(d, n, field[k], s, p)
        _cross(onward[k], s, q)
        across *= te[k]
        within *= tm[k]
        for i in range(3):
            beyond[k, i] = across * s[i] + within * q[i]
    return onward, beyond


@compiled()
def _reflectivity(direction, normal, field, te, tm):
    """[n] |R e| / |e| of waves reflected by planes; arguments as in :func:`fields_beyond`."""
    share = np.empty(len(direction))
    s, p = np.empty(3), np.empty(3)
    for k in range(len(direction)):
        across, within = _parts(direction[k], normal[k], field[k], s, p)
        square = 0.0
        for i in range(3):
            square += field[k, i].real ** 2 + field[k, i].imag ** 2
        across *= te[k]
        within *= tm[k]
        reflected = across.real**2 + across.imag**2 + within.real**2 + within.imag**2
        share[k] = np.sqrt(reflected / square) if square > 0.0 else 0.0
    return share


@inlined()
def _parts(d, n, e, s, p):
    """What a field e has along s = d x n, across the plane of incidence, and along p = d x s, in it."""
    _across(d, n, s)
    _cross(d, s, p)
    across, within = 0.0j, 0.0j
    for i in range(3):
        across += e[i] * s[i]
        within += e[i] * p[i]
    return across, within


@inlined()
def _across(d, n, out):
    """The unit vector d x n across the plane of incidence, of unit vectors."""
    _cross(d, n, out)
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if length < STEEP:
        axis = np.zeros(3)
        axis[np.argmin(np.abs(d))] = 1.0
        _cross(d, axis, out)
        length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for i in range(3):
        out[i] /= length


@inlined()
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
