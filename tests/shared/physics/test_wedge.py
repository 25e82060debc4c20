"""Wedge diffraction against exact solutions: Sommerfeld's half plane, and the eigenfunctions of a wedge."""

import mpmath
import numpy as np
import pytest
from scipy.special import fresnel, jv

from shared.physics.errors import InputError
from shared.physics.wedge import WedgeGeometry, _transition_over_root, diffraction_coefficient

WAVENUMBER = 2.0 * np.pi * 77.5e9 / 299_792_458.0
SOFT, HARD = -1.0, 1.0
GLASS = 6.31 - 0.28j


def geometry(n=1.5, source=0.9, observer=1.0, source_m=20.0, observer_m=20.0, sin_beta=1.0) -> WedgeGeometry:
    return WedgeGeometry(
        *(np.atleast_1d(v).astype(float) for v in (n, source, observer, source_m, observer_m, sin_beta))
    )


def fresnel_te(angle: np.ndarray) -> np.ndarray:
    """Reflection of a half-space for a ray that makes ``angle`` with the surface."""
    cosine = np.abs(np.sin(angle))
    root = np.sqrt(GLASS - 1.0 + cosine**2)
    return (cosine - root) / (cosine + root)


def total_field(n, source, observer, source_m, observer_m, reflection) -> complex:
    """Incident, reflected and diffracted field at one observer in the plane across the edge, spherical waves."""
    sides = {"0": source, "n": n * np.pi - observer}
    r_0, r_n = (reflection(np.array(sides[face])) for face in ("0", "n"))
    rays = geometry(n, source, observer, source_m, observer_m)
    field = diffraction_coefficient(rays, WAVENUMBER, r_0, r_n)[0]
    field *= rays.spreading()[0] * np.exp(-1j * WAVENUMBER * (source_m + observer_m))

    def wave(between: float) -> complex:
        distance = np.sqrt(source_m**2 + observer_m**2 - 2.0 * source_m * observer_m * np.cos(between))
        return np.exp(-1j * WAVENUMBER * distance) / distance

    if abs(observer - source) < np.pi:
        field += wave(observer - source)
    if observer + source < np.pi:
        field += r_0 * wave(observer + source)
    if 2.0 * n * np.pi - observer - source < np.pi:
        field += r_n * wave(2.0 * n * np.pi - observer - source)
    return complex(field)


def field_in_plane_wave(n: float, source: float, observer: np.ndarray, distance: float, reflection: float):
    """The same where the source is far away and shines on the 0-face alone: L = rho."""
    rays = WedgeGeometry(*np.broadcast_arrays(n, source, observer, np.inf, distance, 1.0))
    travel = WAVENUMBER * distance
    field = diffraction_coefficient(rays, WAVENUMBER, reflection, reflection) * np.exp(-1j * travel) / np.sqrt(distance)
    field = field + np.where(np.abs(observer - source) < np.pi, np.exp(1j * travel * np.cos(observer - source)), 0.0)
    mirror = reflection * np.exp(1j * travel * np.cos(observer + source))
    return field + np.where(observer + source < np.pi, mirror, 0.0)


@pytest.mark.parametrize("x", [1e-9, 1e-3, 0.3, 1.0, 5.0, 10.0, 1e2, 1e4])
def test_the_transition_function_is_its_integral(x):
    root = mpmath.sqrt(x)
    tail = mpmath.sqrt(mpmath.pi) / 2 * mpmath.erfc(mpmath.sqrt(1j) * root) / mpmath.sqrt(1j)
    exact = complex(2j * root * mpmath.exp(1j * x) * tail)
    root = np.sqrt(np.array([x]))
    assert (root * _transition_over_root(root))[0] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("reflection", [SOFT, HARD])
def test_a_half_plane_in_a_plane_wave_is_sommerfelds(reflection):
    source, distance = 0.9, 37.0 / WAVENUMBER
    observer = np.linspace(0.05, 2.0 * np.pi - 0.05, 301)

    def half(angle):
        """exp(j k rho cos) times Fresnel's integral from -sqrt(2 k rho) cos(angle / 2), Born and Wolf 11.5."""
        edge = -np.sqrt(2.0 * WAVENUMBER * distance) * np.cos(0.5 * angle)
        sine, cosine = fresnel(edge * np.sqrt(2.0 / np.pi))
        integral = np.sqrt(0.5 * np.pi) * ((0.5 - cosine) - 1j * (0.5 - sine))
        phase = np.exp(1j * WAVENUMBER * distance * np.cos(angle))
        return phase * np.exp(0.25j * np.pi) / np.sqrt(np.pi) * integral

    exact = half(observer - source) + reflection * half(observer + source)
    field = field_in_plane_wave(2.0, source, observer, distance, reflection)
    np.testing.assert_allclose(field, exact, atol=1e-10)


@pytest.mark.parametrize("reflection", [SOFT, HARD])
def test_a_right_angled_corner_is_its_eigenfunction_sum(reflection):
    """UTD is asymptotic: at k rho = 60 it is off by 2.8e-4 of a field of 1."""
    n, source, travel = 1.5, 0.7, 60.0
    observer = np.linspace(0.1, n * np.pi - 0.1, 151)
    order = np.arange(0, 200)[:, None] / n  # J_200/1.5(60) is below 1e-30
    across = np.sin if reflection == SOFT else np.cos
    weight = np.where(order == 0.0, 1.0, 2.0) * 2.0 / n  # Balanis, Advanced Engineering Electromagnetics, 13.8
    terms = (
        weight * np.exp(0.5j * np.pi * order) * jv(order, travel) * across(order * observer) * across(order * source)
    )
    exact = terms.sum(axis=0)
    field = field_in_plane_wave(n, source, observer, travel / WAVENUMBER, reflection)
    np.testing.assert_allclose(field, exact, atol=4e-4)


@pytest.mark.parametrize("n", [1.2, 1.5, 1.75, 2.0])
@pytest.mark.parametrize(
    "reflection", [lambda angle: SOFT, lambda angle: HARD, fresnel_te], ids=["soft", "hard", "glass"]
)
def test_the_total_field_is_continuous_across_both_boundaries(n, reflection):
    step = 1e-9  # so near that the phase along the step is nothing
    source = 0.35 * n
    for boundary in (np.pi + source, np.pi - source):
        if boundary < n * np.pi:
            below, above = (total_field(n, source, boundary + side, 20.0, 11.0, reflection) for side in (-step, step))
            assert abs(above - below) < 1e-3 * max(abs(below), abs(above))


def test_the_n_face_has_its_reflection_boundary_too():
    n, source = 1.5, 1.2 * np.pi
    boundary = 2.0 * n * np.pi - np.pi - source
    below, above = (total_field(n, source, boundary + side, 20.0, 11.0, fresnel_te) for side in (-1e-9, 1e-9))
    assert abs(above - below) < 1e-3 * max(abs(below), abs(above))


def test_the_coefficient_is_finite_exactly_on_its_boundaries():
    source = 0.25 * np.pi
    for observer in (source + np.pi, np.pi - source):
        on, beside = (
            diffraction_coefficient(geometry(1.5, source, observer - off), WAVENUMBER, SOFT, SOFT)[0]
            for off in (0.0, -1e-9)
        )
        assert np.isfinite(on)
        # Half of the field of the wave that ends there.
        assert abs(on) * geometry().spreading()[0] == pytest.approx(0.5 / 40.0, rel=0.02)
        assert abs(beside) == pytest.approx(abs(on), rel=0.02)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n": 0.9}, "exterior_n: 0.9; expected above 1"),
        ({"observer": 5.0}, "observer_angle_rad: 5.0; expected between the faces"),
        ({"source_m": 0.0}, "source_distance_m: 0.0; expected above 0"),
        ({"sin_beta": np.nan}, "sin_beta: nan; expected above 0"),
    ],
)
def test_rays_that_cannot_be_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        geometry(**changes)
