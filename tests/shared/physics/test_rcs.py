"""Radar cross sections against currents integrated over the body, rays counted through corners, and Mie's series."""

import numpy as np
import pytest
from oracles import corner_area, strip
from scipy.special import spherical_jn, spherical_yn

from shared.physics import rcs

WAVELENGTH = 3.868e-3
WAVENUMBER = 2.0 * np.pi / WAVELENGTH


def db(power) -> float:
    return float(10.0 * np.log10(power))


def physical_optics_rcs(points, normals, areas, direction) -> float:
    """sigma = (4 pi / lambda^2) |sum over lit area of (n . d) exp(2 j k d . x)|^2, the far-field integral itself."""
    lit = np.maximum(normals @ direction, 0.0)
    field = np.sum(lit * areas * np.exp(2j * WAVENUMBER * points @ direction))
    return float(4.0 * np.pi / WAVELENGTH**2 * abs(field) ** 2)


@pytest.mark.parametrize("angles_deg", [(0.0, 0.0), (1.3, 0.0), (0.0, 4.0), (2.0, 3.0), (20.0, 11.0), (30.0, 0.3)])
def test_plate_is_the_integral_of_its_currents(angles_deg):
    width, height = 0.11, 0.06
    y, z = (axis.ravel() for axis in np.meshgrid(strip(width, 400), strip(height, 300), indexing="ij"))
    u, v = np.sin(np.radians(angles_deg))
    direction = np.array([np.sqrt(1.0 - u**2 - v**2), u, v])
    points = np.stack([np.zeros_like(y), y, z], axis=1)
    normals = np.tile([1.0, 0.0, 0.0], (len(y), 1))
    integral = physical_optics_rcs(points, normals, width * height / len(y), direction)
    peak = float(rcs.plate_rcs_m2(width, height, WAVELENGTH))
    assert rcs.plate_rcs_m2(width, height, WAVELENGTH, u, v) == pytest.approx(integral, abs=1e-4 * peak, rel=2e-2)
    assert peak == pytest.approx(4.0 * np.pi * (width * height) ** 2 / WAVELENGTH**2)


@pytest.mark.parametrize("psi_deg", [0.0, 0.7, 1.9, 5.0, 15.0])
def test_cylinder_is_the_integral_of_its_currents(psi_deg):
    # Stationary phase, which the formula takes on the curve, is good to a few percent at k r = 81.
    radius, length = 0.05, 0.12
    angle, z = (a.ravel() for a in np.meshgrid(strip(2.0 * np.pi, 3000), strip(length, 200), indexing="ij"))
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    points = radius * normals + np.stack([0.0 * z, 0.0 * z, z], axis=1)
    psi = np.radians(psi_deg)
    direction = np.array([np.cos(psi), 0.0, np.sin(psi)])
    integral = physical_optics_rcs(points, normals, 2.0 * np.pi * radius * length / len(z), direction)
    formula = rcs.cylinder_rcs_m2(radius, length, WAVELENGTH, np.sin(psi))
    assert db(formula) == pytest.approx(db(integral), abs=0.15)
    if psi_deg == 0.0:
        assert formula == pytest.approx(2.0 * np.pi * radius * length**2 / WAVELENGTH)


def mie_over_optical(size: float) -> float:
    """Backscatter of a conducting sphere with k r = ``size`` over pi r^2 (Mie's series; Balanis, eq. 11-247)."""
    n = np.arange(1, int(size + 4.0 * size ** (1 / 3) + 20))
    bessel, neumann = spherical_jn(n, size), spherical_yn(n, size)
    hankel = bessel + 1j * neumann
    slope = bessel + size * spherical_jn(n, size, derivative=True)
    hankel_slope = slope + 1j * (neumann + size * spherical_yn(n, size, derivative=True))
    terms = (-1.0) ** n * (2 * n + 1) * (slope / hankel_slope - bessel / hankel)
    return float(abs(terms.sum()) ** 2 / size**2)


@pytest.mark.parametrize(("beyond", "error_db"), [(7.0, 1.0), (29.0, 0.1)])
def test_sphere_is_the_series_within_the_stated_error(beyond, error_db):
    assert rcs.sphere_rcs_m2(0.3) == pytest.approx(np.pi * 0.09)
    errors = [abs(db(mie_over_optical(size))) for size in np.arange(beyond, 60.0, 0.05)]
    assert max(errors) <= error_db
    assert max(abs(db(mie_over_optical(size))) for size in np.arange(0.7 * beyond, beyond, 0.05)) > error_db


@pytest.mark.parametrize("cosines", [(1, 1, 1), (1, 1.5, 2), (0.4, 1, 2), (0.2, 0.3, 1), (3, 1, 2)])
def test_trihedral_is_the_area_that_three_bounces_light(cosines):
    edge, direction = 0.1, np.array(cosines, dtype=float) / np.linalg.norm(cosines)
    area = corner_area(np.eye(3), lambda _, p: (p >= -1e-9).all(axis=1) & (p.sum(axis=1) <= edge), direction, edge, 700)
    expected = 4.0 * np.pi * area**2 / WAVELENGTH**2
    assert db(rcs.trihedral_rcs_m2(edge, WAVELENGTH, direction)) == pytest.approx(db(expected), abs=0.05)


def test_trihedral_on_its_axis():
    assert rcs.trihedral_rcs_m2(0.2, WAVELENGTH) == pytest.approx(4.0 * np.pi * 0.2**4 / (3.0 * WAVELENGTH**2))
    assert rcs.trihedral_rcs_m2(0.2, WAVELENGTH, [-0.1, 0.7, 0.7]) == 0.0


@pytest.mark.parametrize("azimuth_deg", [0.0, 10.0, -25.0, 40.0])
def test_dihedral_is_the_area_that_two_bounces_light(azimuth_deg):
    face, length = 0.08, 0.15
    # Faces along x and y, edge along z; the bisector is at 45 deg.
    angle = np.radians(45.0 + azimuth_deg)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])

    def inside(_, p):
        return (p >= -1e-9).all(axis=1, where=[True, True, False]) & (p[:, :2] <= face).all(axis=1) & (
            np.abs(p[:, 2]) <= length / 2.0
        )  # fmt: skip

    area = corner_area(np.eye(3)[:2], inside, direction, 0.2)
    expected = 4.0 * np.pi * area**2 / WAVELENGTH**2
    value = rcs.dihedral_rcs_m2(face, length, WAVELENGTH, np.radians(azimuth_deg))
    assert db(value) == pytest.approx(db(expected), abs=0.1)


def test_dihedral_at_its_best_and_beside_it():
    peak = float(rcs.dihedral_rcs_m2(0.1, 0.2, WAVELENGTH))
    assert peak == pytest.approx(8.0 * np.pi * (0.1 * 0.2) ** 2 / WAVELENGTH**2)
    assert rcs.dihedral_rcs_m2(0.1, 0.2, WAVELENGTH, np.pi / 4.0) == pytest.approx(0.0, abs=1e-12 * peak)
    # Along the edge it is a mirror of the edge's length: the first null of a plate as high.
    null = WAVELENGTH / (2.0 * 0.2)
    assert rcs.dihedral_rcs_m2(0.1, 0.2, WAVELENGTH, 0.0, null) == pytest.approx(0.0, abs=1e-12 * peak)


def test_the_far_field_begins_where_the_rim_is_an_eighth_of_a_wavelength_late():
    distance = rcs.far_field_m(0.3, WAVELENGTH)
    late = 2.0 * (np.hypot(distance, 0.15) - distance)
    assert late == pytest.approx(WAVELENGTH / 8.0, rel=1e-3)
