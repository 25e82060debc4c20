"""Radar cross sections of simple bodies of metal, monostatic, by the high-frequency formulas of the textbooks.

Every body is large against the wavelength and seen from its far field, R >= 2 D^2 / lambda (:func:`far_field_m`), D its
largest extent across the line of sight. Nearer, the echo is weaker than the formula says: at 1, 1/2 and 1/4 of that
distance by 0.1, 0.5 and 1.9 dB for a square plate seen along its normal (D its diagonal), by 0.2, 1.0 and 4.0 dB for a
cylinder at broadside (D its length). Polarisation plays no part in these formulas. Sources: Knott, Shaeffer and
Tuley, Radar Cross Section, 2nd ed., chapters 5 and 6; Balanis, Advanced Engineering Electromagnetics, 2nd ed., section
11.3. Limits and errors stated here were found by integrating the currents and by Mie's series, and are asserted in
``tests/shared/physics/test_rcs.py``.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from shared.physics.units import ArrayOrScalar

Real = Float64[ArrayOrScalar, "..."]
"""Of the shape to which the arguments broadcast."""


def far_field_m(extent_m: float, wavelength_m: float) -> float:
    """2 D^2 / lambda [m]: where the round trip to the rim of an extent D is lambda / 8 longer than to its middle."""
    return 2.0 * extent_m**2 / wavelength_m


def sphere_rcs_m2(radius_m: float) -> float:
    """pi r^2 [m^2]. Against Mie's series: within 1 dB from k r = 7 on, within 0.1 dB from k r = 29 on."""
    return float(np.pi * radius_m**2)


def plate_rcs_m2(
    width_m: float, height_m: float, wavelength_m: float, u_width: ArrayLike = 0.0, u_height: ArrayLike = 0.0
) -> Real:
    """A flat rectangular plate [m^2], by physical optics; 4 pi A^2 / lambda^2 along its normal.

        sigma = 4 pi A^2 / lambda^2 cos^2(theta) sinc^2(k w u_w) sinc^2(k h u_h)

    Good within about 30 deg of the normal; further out the edges' diffraction, left out here, takes over.

    :param u_width: [...] cosine between line of sight and the plate's width; 0 along the normal
    :param u_height: [...] the same of its height
    """
    u_width, u_height = np.asarray(u_width, dtype=np.float64), np.asarray(u_height, dtype=np.float64)
    cosine_squared = np.maximum(1.0 - u_width**2 - u_height**2, 0.0)
    peak = 4.0 * np.pi * (width_m * height_m / wavelength_m) ** 2
    # NumPy's sinc(x) is sin(pi x) / (pi x): k w u = pi (2 w u / lambda).
    lobe = np.sinc(2.0 * width_m * u_width / wavelength_m) * np.sinc(2.0 * height_m * u_height / wavelength_m)
    return peak * cosine_squared * lobe**2


def cylinder_rcs_m2(radius_m: float, length_m: float, wavelength_m: float, u_axis: ArrayLike = 0.0) -> Real:
    """The curved side of a circular cylinder [m^2], by physical optics; 2 pi r L^2 / lambda at broadside.

        sigma = k r L^2 cos(psi) sinc^2(k L sin(psi))

    Good for k r > 10 and within about 30 deg of broadside; the flat ends are left out.

    :param u_axis: [...] sin(psi), cosine between line of sight and the axis; 0 at broadside
    """
    u_axis = np.asarray(u_axis, dtype=np.float64)
    cosine = np.sqrt(np.maximum(1.0 - u_axis**2, 0.0))
    peak = 2.0 * np.pi * radius_m * length_m**2 / wavelength_m
    return peak * cosine * np.sinc(2.0 * length_m * u_axis / wavelength_m) ** 2


def dihedral_rcs_m2(
    face_m: float, length_m: float, wavelength_m: float, azimuth_rad: ArrayLike = 0.0, u_edge: ArrayLike = 0.0
) -> Real:
    """A right-angled dihedral of two faces a x b [m^2], double bounce alone; 8 pi a^2 b^2 / lambda^2 at its best.

    It reflects like a plate as large as what both faces light in turn, by geometric optics:

        sigma = 4 pi A^2 / lambda^2 sinc^2(k b u_b),   A = 2 a b sin(45 deg - |phi|) sqrt(1 - u_b^2)

    Good for a and b of many wavelengths, while the faces' own glints stay off: |phi| < 45 deg - lambda / 2a, about.

    :param face_m: side a of a face across the edge [m]; :param length_m: length b of the edge [m]
    :param azimuth_rad: [...] angle phi from the bisector, in the plane across the edge
    :param u_edge: [...] cosine between line of sight and the edge
    """
    azimuth, u_edge = np.asarray(azimuth_rad, dtype=np.float64), np.asarray(u_edge, dtype=np.float64)
    open_angle = np.maximum(np.pi / 4.0 - np.abs(azimuth), 0.0)
    area = 2.0 * face_m * length_m * np.sin(open_angle) * np.sqrt(np.maximum(1.0 - u_edge**2, 0.0))
    return 4.0 * np.pi * (area / wavelength_m) ** 2 * np.sinc(2.0 * length_m * u_edge / wavelength_m) ** 2


def trihedral_rcs_m2(edge_m: float, wavelength_m: float, cosines: ArrayLike | None = None) -> Real:
    """A trihedral of three right-angled triangles [m^2], triple bounce alone; 4 pi a^4 / 3 lambda^2 on its axis.

    sigma = 4 pi A^2 / lambda^2 with the area that all three faces light in turn, by geometric optics, for direction
    cosines l <= m <= n to the three inner edges:

        A = a^2 (4 l m / (l + m + n))                 where l + m <= n
        A = a^2 (l + m + n - 2 / (l + m + n))         elsewhere

    Good for edges of many wavelengths; the faces' own glints and the double bounces near the planes are left out.

    :param edge_m: length a of the three edges that meet in the apex [m]
    :param cosines: [..., 3] to the edges; zero where one is negative, i.e. seen from behind; None for the axis
    """
    if cosines is None:
        cosines = np.full(3, 1.0 / np.sqrt(3.0))
    low, middle, high = np.moveaxis(np.sort(np.asarray(cosines, dtype=np.float64), axis=-1), -1, 0)
    total = np.where(low > 0.0, low + middle + high, 1.0)
    area = np.where(low + middle <= high, 4.0 * low * middle / total, total - 2.0 / total)
    area = edge_m**2 * np.where(low > 0.0, area, 0.0)
    return 4.0 * np.pi * (area / wavelength_m) ** 2
