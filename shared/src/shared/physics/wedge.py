"""Diffraction by a straight wedge: the uniform theory of diffraction (UTD).

Kouyoumjian and Pathak, "A uniform geometrical theory of diffraction for an edge in a perfectly conducting surface",
Proc. IEEE 62 (1974), doi 10.1109/PROC.1974.9651: with unit vectors along the rays s' (to the edge) and s (from it),

    E_d(s) = E_i(Q) . D sqrt(s' / (s (s' + s))) exp(-j k s)

for a spherical wave of s' = distance from the source, s = distance to the observer. Between the faces of a wedge whose
exterior angle is n pi, angles phi' (source) and phi (observer) are measured from the 0-face, beta_0 is the angle
between ray and edge (equal on both sides: Keller's cone), L = s s' sin^2(beta_0) / (s + s'), and

    D = -exp(-j pi/4) / (2 n sqrt(2 pi k) sin beta_0) *
        { (1 - T) [ cotF(pi + (phi - phi')) + cotF(pi - (phi - phi')) ]
          +         R_n cotF(pi + (phi + phi')) + R_0 cotF(pi - (phi + phi')) },
    cotF(x) = cot(x / 2n) F(k L a(x)),  a(x) = 2 sin^2((x - 2 pi n N) / 2),  N = round(x / (2 pi n)).

Perfect conductor: R_0 = R_n = -1 for the electric field along the edge ("soft", D_s) and +1 for the magnetic field
along it ("hard", D_h). Real faces: the Fresnel coefficients of the 0-face at the source's angle and of the n-face at
the observer's, the 0-face being the source's (Luebbers, IEEE Trans. AP-32 (1984), doi 10.1109/TAP.1984.1143189), TE
for soft and TM for hard: a heuristic, right on the boundaries and continuous between them. T is what a sheet (n = 2)
lets through of the wave that meets it, so that a sheet of air diffracts nothing (Burnside and Burgener, IEEE Trans.
AP-31 (1983)). T is 0 for a solid.

Valid for k L of a few and more (nearer to the edge the wave is no ray), straight edges, plane faces larger than a
Fresnel zone. Exact for the perfectly conducting half plane in a plane wave (Sommerfeld). At exactly grazing incidence
on a hard face the incident and the reflected wave are one, and half of D is to be used (Kouyoumjian and Pathak,
section IV).

Time convention exp(+j omega t), as in propagation; the path table wants the conjugate.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Complex128, Float, Float64, Int
from numpy.typing import ArrayLike, NDArray
from scipy.special import modfresnelm

from shared.physics.errors import InputError
from shared.physics.units import ArrayOrScalar

Real = Float64[ArrayOrScalar, "..."]
Complex = Complex128[ArrayOrScalar, "..."]
PerRay = Float[np.ndarray, " rays"]


def _transition_over_root(root: Real) -> Complex:
    """F(x) / sqrt(x) at sqrt(x) = ``root`` >= 0: finite at 0, where F itself vanishes; F is near 1 beyond 10.

    F(x) = 2j sqrt(x) exp(jx) int_sqrt(x)^inf exp(-j t^2) dt.

    SciPy's K_-(r) = exp(j (r^2 + pi/4)) / sqrt(pi) int_r^inf exp(-j t^2) dt takes the fast phase off within.
    """
    _, kernel = modfresnelm(root)
    return 2.0 * np.sqrt(np.pi) * np.exp(0.25j * np.pi) * kernel


@dataclass(frozen=True)
class WedgeGeometry:
    """K diffracted rays, seen in the wedges' own coordinates.

    :param exterior_n: [K] n: the exterior angle is n pi, 1 < n <= 2
    :param source_angle_rad: [K] phi' of the source, from the 0-face, 0 to n pi
    :param observer_angle_rad: [K] phi of the observer
    :param source_distance_m: [K] s' from the source to the edge [m]; infinite for a plane wave
    :param observer_distance_m: [K] s from the edge to the observer [m]
    :param sin_beta: [K] sine of the angle between ray and edge, above 0
    :raises InputError: an angle or a distance that no ray can have
    """

    exterior_n: PerRay
    source_angle_rad: PerRay
    observer_angle_rad: PerRay
    source_distance_m: PerRay
    observer_distance_m: PerRay
    sin_beta: PerRay

    def __post_init__(self) -> None:
        n = np.asarray(self.exterior_n)
        _require((n > 1.0) & (n <= 2.0), "exterior_n", n, "above 1 and at most 2")
        for name in ("source_angle_rad", "observer_angle_rad"):
            angle = np.asarray(getattr(self, name))
            _require((angle >= 0.0) & (angle <= n * np.pi), name, angle, "between the faces, 0 to n pi")
        for name in ("source_distance_m", "observer_distance_m", "sin_beta"):
            value = np.asarray(getattr(self, name))
            _require(value > 0.0, name, value, "above 0")

    def take(self, index: Int[np.ndarray, " taken"] | Bool[np.ndarray, " rays"]) -> WedgeGeometry:
        """The rays at these indices, or where a mask is true."""
        return WedgeGeometry(**{item.name: getattr(self, item.name)[index] for item in fields(self)})

    def spreading(self) -> PerRay:
        """[K] 1 / sqrt(s s' (s + s')): field at the observer over D times the source's field at 1 m [m^-1.5]."""
        out, back = self.source_distance_m, self.observer_distance_m
        return 1.0 / np.sqrt(out * back * (out + back))


def diffraction_coefficient(
    geometry: WedgeGeometry,
    wavenumber: float,
    reflection_0: ArrayLike,
    reflection_n: ArrayLike,
    transmission: ArrayLike = 0.0,
) -> Complex128[np.ndarray, " rays"]:
    """D of the module's equation, for one polarisation.

    :param geometry: K rays
    :param wavenumber: k = 2 pi / lambda [rad/m]
    :param reflection_0: [K] R_0 of the 0-face at the source's angle; -1 soft and +1 hard for a perfect conductor
    :param reflection_n: [K] R_n of the n-face at the observer's angle
    :param transmission: [K] T through a sheet, relative to the air in its place
    :return: [K] complex [sqrt(m)]; finite on the boundaries of shadow and reflection too: the limit from one side
    """
    n = np.asarray(geometry.exterior_n, dtype=np.float64)
    # sqrt(k L), in a form that takes an infinite s'
    nearness = 1.0 / geometry.observer_distance_m + 1.0 / geometry.source_distance_m
    scale = np.sqrt(wavenumber * (geometry.sin_beta**2 / nearness))
    difference = geometry.observer_angle_rad - geometry.source_angle_rad
    total = geometry.observer_angle_rad + geometry.source_angle_rad
    incident = _cotangent_times_transition(np.pi + difference, n, scale)
    incident = incident + _cotangent_times_transition(np.pi - difference, n, scale)
    reflected = np.asarray(reflection_n) * _cotangent_times_transition(np.pi + total, n, scale)
    reflected = reflected + np.asarray(reflection_0) * _cotangent_times_transition(np.pi - total, n, scale)
    factor = -np.exp(-0.25j * np.pi) / (2.0 * n * np.sqrt(2.0 * np.pi * wavenumber) * geometry.sin_beta)
    return factor * ((1.0 - np.asarray(transmission)) * incident + reflected)


def _cotangent_times_transition(angle: Real, n: Real, scale: Real) -> Complex:
    """cot(x / 2n) F(k L a(x)), with ``scale`` = sqrt(k L).

    With d = x - 2 pi n N the distance from the nearest pole of the cotangent, sqrt(k L a) = sqrt(2 k L) |sin(d / 2)|,
    so that the cotangent's pole is multiplied by a zero: |sin(d/2)| cot(d / 2n) is sign(d) n at d = 0.
    """
    distance = angle - 2.0 * np.pi * n * np.round(angle / (2.0 * np.pi * n))
    near = np.maximum(np.abs(distance), 1e-12)  # both sines are linear there: the ratio is n to the last digit
    ratio = np.where(distance < 0.0, -1.0, 1.0) * np.sin(0.5 * near) / np.tan(near / (2.0 * n))
    root = np.sqrt(2.0) * scale
    return root * ratio * _transition_over_root(root * np.abs(np.sin(0.5 * distance)))


def _require(good: NDArray[np.bool_], name: str, value: NDArray, expected: str) -> None:
    if not np.all(good):
        found = np.atleast_1d(value)[np.argmin(np.atleast_1d(np.broadcast_to(good, np.shape(value))))]
        raise InputError(f"wedge {name}", f"{float(found)!r}", expected)
