"""Element patterns: what they promise about power and width."""

from __future__ import annotations

import numpy as np
import pytest

from shared.antenna import IsotropicPattern, ParabolicPattern, car_radar_pattern


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def mean_gain(pattern) -> float:
    """Power gain averaged over the sphere: 1 for a lossless element, by the conservation of energy."""
    z, weight = np.polynomial.legendre.leggauss(2000)  # uniform in the sine of elevation
    azimuth = 2.0 * np.pi * (np.arange(720) + 0.5) / 720
    rho = np.sqrt(1.0 - z**2)
    directions = np.stack(
        [np.outer(rho, np.cos(azimuth)), np.outer(rho, np.sin(azimuth)), np.repeat(z[:, None], 720, axis=1)], axis=-1
    )
    return float(weight @ pattern.power_gain(directions).mean(axis=1) / 2.0)


def test_the_car_radars_element_is_lossless():
    assert 10.0 * np.log10(mean_gain(car_radar_pattern())) == pytest.approx(0.0, abs=0.05)


def test_isotropic_is_isotropic():
    assert mean_gain(IsotropicPattern()) == pytest.approx(1.0)
    np.testing.assert_allclose(IsotropicPattern(gain_dbi=3.0).power_gain(np.ones((4, 5, 3))), 10.0**0.3)


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(55.0, 0.0), (-55.0, 0.0), (0.0, 6.5), (0.0, -6.5)])
def test_two_way_widths_are_110_and_13_degrees(azimuth_deg, elevation_deg):
    pattern = car_radar_pattern()
    gains = pattern.power_gain(np.stack([direction(azimuth_deg, elevation_deg), direction(0.0, 0.0)])) ** 2
    assert 10.0 * np.log10(gains[0] / gains[1]) == pytest.approx(-3.0, abs=1e-9)


def test_gain_and_floor():
    pattern = ParabolicPattern(gain_dbi=10.0, azimuth_beamwidth_deg=60.0, elevation_beamwidth_deg=20.0, floor_db=25.0)
    levels = 10.0 * np.log10(
        pattern.power_gain(np.stack([direction(0, 0), direction(30, 0), direction(30, 10), direction(180, 0)]))
    )
    np.testing.assert_allclose(levels, [10.0, 7.0, 4.0, -15.0], atol=1e-9)


def test_length_does_not_matter_and_zero_is_boresight():
    pattern = car_radar_pattern()
    one = direction(20.0, 3.0)
    assert pattern.power_gain(one) == pytest.approx(float(pattern.power_gain(37.0 * one)))
    assert pattern.power_gain(np.zeros(3)) == pytest.approx(float(pattern.power_gain(direction(0, 0))))
