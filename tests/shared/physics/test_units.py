"""Constants and conversions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

from shared.physics.units import (
    BOLTZMANN,
    SPEED_OF_LIGHT,
    amplitude_to_db,
    db_to_power,
    dbm_to_watt,
    power_to_db,
)


def test_constants_are_those_of_the_si():
    assert constants.speed_of_light == SPEED_OF_LIGHT
    assert constants.Boltzmann == BOLTZMANN


@given(st.floats(-390.0, 300.0))
def test_decibels_come_back(level_db):
    assert power_to_db(db_to_power(level_db)) == pytest.approx(level_db, abs=1e-9)
    assert amplitude_to_db(np.sqrt(db_to_power(level_db))) == pytest.approx(level_db, abs=1e-9)


def test_known_levels():
    np.testing.assert_allclose(db_to_power([0.0, 10.0, -30.0]), [1.0, 10.0, 1e-3])
    np.testing.assert_allclose(power_to_db([1.0, 100.0]), [0.0, 20.0], atol=1e-12)
    np.testing.assert_allclose(amplitude_to_db([1.0, -10.0, 10.0j]), [0.0, 20.0, 20.0], atol=1e-12)
    assert dbm_to_watt(30.0) == pytest.approx(1.0)
    assert dbm_to_watt(0.0) == pytest.approx(1e-3)


def test_silence_has_a_finite_level():
    np.testing.assert_allclose(power_to_db([0.0, 1e-300]), -400.0)
    np.testing.assert_allclose(amplitude_to_db(np.zeros(2)), -400.0)
    assert power_to_db(0.0, floor_db=-90.0) == pytest.approx(-90.0)
    assert amplitude_to_db(np.float32(0.0), floor_db=-90.0) == pytest.approx(-90.0)
