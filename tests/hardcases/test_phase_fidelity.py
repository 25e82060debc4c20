"""The figure can fail: phases that are known to be bad give a bad one."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hardcases.phase_fidelity import FLOOR_DB, PHASE_DEG, YAW_DEG, fidelity, radar, sidelobe_floor_db

from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.common import vertex_spacing_m
from shared.physics.units import SPEED_OF_LIGHT
from shared.signal.sweep import reference_frequency_hz

pytestmark = pytest.mark.usefixtures("variant")


def delays(point: np.ndarray) -> np.ndarray:
    """[256] round trip of a point to the virtual sensor's elements [s]."""
    sensor = radar().virtual_sensor
    legs = np.linalg.norm(point - sensor.rx, axis=1) + np.linalg.norm(point - sensor.tx[0])
    return legs / SPEED_OF_LIGHT


def test_no_error_leaves_the_windows_own_floor() -> None:
    assert sidelobe_floor_db(np.zeros(256)) < -180.0


def test_a_slope_of_phase_moves_the_main_lobe_and_raises_no_floor() -> None:
    assert sidelobe_floor_db(np.linspace(-0.5, 0.5, 256)) < -180.0


def test_float32_delays_raise_the_floor_to_minus_40_db() -> None:
    exact = delays(np.array([160.0, 118.0, 20.0]))
    error = 2.0 * np.pi * reference_frequency_hz(radar()) * (exact.astype(np.float32).astype(np.float64) - exact)
    assert -60.0 < sidelobe_floor_db(error) < -20.0


def test_float32_vertices_at_500_km_break_the_phase_bound() -> None:
    world = np.array([500_004.0123, 350_002.95, 0.51])
    pose = np.array([500_000.0, 350_000.0, 0.5])
    error = delays(world.astype(np.float32).astype(np.float64) - pose) - delays(world - pose)
    degrees = 360.0 * reference_frequency_hz(radar()) * (error - error[0])
    assert np.abs(degrees).max() > 100.0 * PHASE_DEG
    assert vertex_spacing_m(world[None].astype(np.float32), np.eye(4)) == 2.0**-5


def test_the_figure_is_that_of_one_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """An attitude that is 1e-3 deg off breaks the bound: a quarter of a degree between the ends of 0.5 m."""
    good = fidelity("point target", 50.0, 0.0)
    assert good.array_deg < PHASE_DEG
    assert good.floor_db < FLOOR_DB
    fidelity.cache_clear()
    elsewhere = mpmath.matrix(Pose((0.0, 0.0, 0.0), YAW_DEG + 1e-3).rotation().tolist())
    monkeypatch.setattr("hardcases.phase_fidelity._turn", lambda: elsewhere)
    assert fidelity("point target", 50.0, 0.0).array_deg > PHASE_DEG
    fidelity.cache_clear()
