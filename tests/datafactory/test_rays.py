"""The ray fan: directions, density, and the solid angle that each ray stands for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from datafactory.paths.rays import RayFan


def directions_of(fan: RayFan) -> NDArray[np.float64]:
    """[count, 3] by the map that Mitsuba documents: azimuth 2 pi a, z = 1 - 2 b."""
    a, b = fan.unit_square().T
    z = 1.0 - 2.0 * b
    rho = np.sqrt(1.0 - z**2)
    return np.stack([rho * np.cos(2.0 * np.pi * a), rho * np.sin(2.0 * np.pi * a), z], axis=1)


@pytest.mark.usefixtures("variant")
def test_mitsuba_maps_the_square_as_claimed():
    import mitsuba as mi

    fan = RayFan(5_000, (0.2, 0.7))
    a, b = fan.unit_square().T.astype(np.float32)
    mapped = mi.warp.square_to_uniform_sphere(mi.Point2f(a, b)).numpy().T
    np.testing.assert_allclose(mapped, directions_of(fan), atol=3e-6)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.37, 0.81)])
def test_rays_look_ahead_uniformly_in_azimuth(offset):
    x, y, _ = directions_of(RayFan(20_000, offset)).T
    assert (x > -1e-12).all()
    counts, _ = np.histogram(np.arctan2(y, x), bins=20, range=(-np.pi / 2.0, np.pi / 2.0))
    np.testing.assert_allclose(counts, 1000, atol=20)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.37, 0.81)])
def test_elevation_has_the_stated_density(offset):
    fan = RayFan(20_000, offset, horizon=0.02)
    z = np.sort(directions_of(fan)[:, 2])
    # The integral of p(z) from -1: a half plus asinh(z / z_0) / (2 asinh(1 / z_0)).
    share = 0.5 + np.arcsinh(z / 0.02) / (2.0 * np.arcsinh(1.0 / 0.02))
    np.testing.assert_allclose(share, (np.arange(20_000) + 0.5) / 20_000, atol=1.5 / 20_000)


@pytest.mark.parametrize("horizon", [0.005, 0.01, 0.1])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.37, 0.81)])
def test_solid_angles_fill_the_front_half_space(horizon, offset):
    fan = RayFan(20_000, offset, horizon)
    directions = directions_of(fan)
    solid_angle = 4.0 * np.pi / fan.count * fan.solid_angle_ratio(directions)
    assert solid_angle.sum() == pytest.approx(2.0 * np.pi, rel=1e-3)
    # ... and any part of it: here the cap within 60 deg of boresight, 2 pi (1 - cos 60 deg).
    assert solid_angle[directions[:, 0] > 0.5].sum() == pytest.approx(np.pi, rel=2e-2)


def test_solid_angle_does_not_depend_on_the_vectors_length():
    fan = RayFan(100)
    directions = directions_of(fan)
    np.testing.assert_allclose(fan.solid_angle_ratio(17.0 * directions), fan.solid_angle_ratio(directions))


def test_rays_are_dense_at_the_horizon():
    fan = RayFan(10_000)
    ratio = fan.solid_angle_ratio(np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]]))
    assert ratio[0] < 0.1 < 1.0 < ratio[1]


def test_offsets_move_the_lattice_and_nothing_else():
    first, second = RayFan(1_000).unit_square(), RayFan(1_000, (0.5, 0.25)).unit_square()
    assert not np.allclose(first, second)
    np.testing.assert_allclose(first, RayFan(1_000, (1.0, 0.0)).unit_square(), atol=1e-12)
    assert first.tobytes() == RayFan(1_000).unit_square().tobytes()
    for square in (first, second):
        assert square.shape == (1_000, 2)
        assert square.min() >= 0.0
        assert square.max() <= 1.0
