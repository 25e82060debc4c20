"""Scattering patterns: what is spread is what was taken; the way back; Sionna's own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from datafactory.paths.scattering import has_lobes, share_at
from datafactory.scenes.materials.table import Pattern

NORMAL = np.array([0.0, 0.0, 1.0])
ANGLES_DEG = (0.0, 20.0, 45.0, 70.0, 89.0)


def arriving(angle_deg: float) -> np.ndarray:
    angle = np.radians(angle_deg)
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def share(pattern, arrival, departure):
    arrival, departure = np.broadcast_arrays(np.atleast_2d(arrival), np.atleast_2d(departure))
    turned = np.einsum("ki,ki->k", arrival, departure)
    lobes = has_lobes(pattern)
    return np.array(
        [share_at(lobes, -a @ NORMAL, d @ NORMAL, c) for a, d, c in zip(arrival, departure, turned, strict=True)]
    )


@pytest.mark.parametrize("pattern", ["lambertian", "backscattering"])
@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_nothing_is_lost_and_nothing_won(pattern, angle_deg):
    # Gauss-Legendre in cos(theta), trapezoid in azimuth: exact for these polynomials to rounding.
    node, weight = np.polynomial.legendre.leggauss(40)
    cosine, azimuth = 0.5 * (node + 1.0), 2.0 * np.pi * np.arange(64) / 64
    c, a = (grid.ravel() for grid in np.meshgrid(cosine, azimuth, indexing="ij"))
    s = np.sqrt(1.0 - c**2)
    values = share(pattern, arriving(angle_deg), np.stack([s * np.cos(a), s * np.sin(a), c], axis=1))
    total = (values.reshape(40, 64).mean(axis=1) * 2.0 * np.pi * 0.5 * weight).sum()
    assert total == pytest.approx(1.0, abs=1e-4)


def test_the_way_back_from_a_tilted_plane():
    angle = np.radians(np.array(ANGLES_DEG))
    back = [float(share("lambertian", arriving(a), -arriving(a))[0]) for a in ANGLES_DEG]
    np.testing.assert_allclose(back, np.cos(angle) / np.pi, rtol=1e-12)
    lobes = [float(share("backscattering", arriving(a), -arriving(a))[0]) for a in ANGLES_DEG]
    # At normal incidence both lobes are one, ((1 + c) / 2)^4, whose integral is 2 pi (1 - 1 / 32) / 5 * 2.
    assert lobes[0] == pytest.approx(1.0 / (4.0 * np.pi / 5.0 * (1.0 - 1.0 / 32.0)), rel=1e-12)
    # Back at grazing incidence one lobe alone is heard: half of it, over the same share of the half space.
    assert lobes[-1] > 0.5 * lobes[0]


@pytest.mark.usefixtures("variant")
def test_patterns_are_sionnas():
    import mitsuba as mi
    from sionna.rt.radio_materials.scattering_pattern import BackscatteringPattern, LambertianPattern

    random = np.random.default_rng(1)
    arrival, departure = random.normal(size=(2, 500, 3))
    arrival[:, 2], departure[:, 2] = -np.abs(arrival[:, 2]), np.abs(departure[:, 2])
    arrival, departure = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (arrival, departure))
    theirs: dict[Pattern, Any] = {"lambertian": LambertianPattern(), "backscattering": BackscatteringPattern(4, 4, 0.5)}
    for pattern, own in theirs.items():
        expected = own(mi.Vector3f(*arrival.T.astype(np.float32)), mi.Vector3f(*departure.T.astype(np.float32))).numpy()
        np.testing.assert_allclose(share(pattern, arrival, departure), expected, rtol=2e-5)
