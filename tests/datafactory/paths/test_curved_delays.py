"""Delays of curved mirrors against shortest paths, for every TX and RX, standing and moving."""

from __future__ import annotations

import numpy as np
import pytest
from curved_bodies import (
    cylinder,
    sphere,
)
from curved_scenes import (
    Real,
    body,
    traced,
    turned,
)
from oracles import LIGHT_MPS, scattered_delays, specular_delays
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from datafactory.paths.table import ScatteredPaths, SpecularPaths
from datafactory.scenes.poses import Pose

pytestmark = pytest.mark.usefixtures("variant")


def law_length(path: ScatteredPaths | SpecularPaths, tx: Real, rx: Real, time_s: float = 0.0) -> float:
    if isinstance(path, ScatteredPaths):
        return float(scattered_delays(path, tx, rx, time_s)[0]) * LIGHT_MPS
    return float(specular_delays(path, tx, rx, time_s)[0]) * LIGHT_MPS


def shortest(surface, start: Real, tx: Real, rx: Real) -> float:
    """Length of the shortest path over a surface, ``surface(parameters)`` [3]."""

    def length(parameters: Real) -> float:
        point = surface(parameters)
        return float(np.linalg.norm(point - tx) + np.linalg.norm(point - rx))

    found = minimize(length, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000})
    return float(found.fun)


def law_error_m(tx: Real, rx: Real, range_m: float, k: float, law: type) -> float:
    """The bound of the module's docstring."""
    a, b = float(np.linalg.norm(tx)), float(np.linalg.norm(rx))
    if law is SpecularPaths:
        return (a + b) ** 2 * k / 4.0
    s = 2.0 * range_m / (1.0 + range_m * k)
    return a * b * abs(1.0 / range_m - k) / 2.0 + a**2 * abs(1.0 / s - 1.0 / (2.0 / k - s)) / 2.0


@pytest.mark.parametrize(("radius", "range_m"), [(0.3, 1.5), (1.0, 4.0), (5.0, 3.0), (40.0, 4.0)])
def test_the_path_of_every_tx_and_rx_over_a_sphere(radius, range_m):
    direction = np.array([0.9, 0.3, 0.1]) / np.linalg.norm([0.9, 0.3, 0.1])
    centre = (range_m + radius) * direction
    table = traced(body(sphere(radius, 48), centre, turned(2)))
    path = table.scattered if len(table.scattered) else table.specular

    def surface(parameters: Real) -> Real:
        level, turn = parameters
        away = np.array([np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)])
        return centre - radius * away

    start = np.array([np.arcsin(direction[2]), np.arctan2(direction[1], direction[0])])
    for tx_y, rx_y in ((0.0, 0.25), (0.0, -0.25), (-0.05, 0.05), (-0.05, -0.25), (0.05, 0.05)):
        tx, rx = np.array([0.0, tx_y, 0.0]), np.array([0.0, rx_y, 0.0])
        true = shortest(surface, start, tx, rx)
        bound = law_error_m(tx, rx, range_m, 1.0 / (range_m + radius), type(path))
        cubic = (abs(tx_y) + abs(rx_y)) ** 3 / range_m**2
        assert abs(law_length(path, tx, rx) - true) < bound + cubic
        plain = 2.0 * range_m - direction[1] * (tx_y + rx_y)
        assert abs(law_length(path, tx, rx) - true) < 0.5 * abs(plain - true) + cubic  # the law does help


@pytest.mark.parametrize("upright", [True, False])
def test_the_path_of_every_tx_and_rx_over_a_cylinder(upright):
    radius, range_m = 0.5, 3.0
    turn = Rotation.identity() if upright else Rotation.from_euler("x", 90.0, degrees=True)
    table = traced(body(cylinder(radius, 6.0, 60), (range_m + radius, 0.0, 0.0), turn))
    path = table.scattered if upright else table.specular
    assert len(path) == 1

    def surface(parameters: Real) -> Real:
        turned_by, along = parameters
        local = np.array([-radius * np.cos(turned_by), radius * np.sin(turned_by), along])
        return np.array([range_m + radius, 0.0, 0.0]) + turn.apply(local)

    for tx_y, rx_y in ((0.0, 0.25), (-0.05, 0.05), (-0.05, -0.25)):
        tx, rx = np.array([0.0, tx_y, 0.0]), np.array([0.0, rx_y, 0.0])
        true = shortest(surface, np.zeros(2), tx, rx)
        bound = law_error_m(tx, rx, range_m, 1.0 / (range_m + radius), ScatteredPaths) if upright else 0.0
        assert abs(law_length(path, tx, rx) - true) < bound + (abs(tx_y) + abs(rx_y)) ** 4 / range_m**3 + 1e-9


@pytest.mark.parametrize("radius", [0.3, 1.5, 60.0])
def test_a_moving_sphere_has_the_delay_of_its_own_geometry(radius):
    centre, velocity = np.array([5.0 + radius, 1.0, 0.2]), np.array([-8.0, 14.0, 3.0])
    table = traced(body(sphere(radius, 64), centre, turned(3), velocity=tuple(velocity)))
    path = table.scattered if len(table.scattered) else table.specular
    nowhere, distance = np.zeros(3), np.linalg.norm(centre)
    across = np.linalg.norm(velocity - velocity @ centre / distance**2 * centre)
    for time_s in (-0.01, 0.005, 0.01):
        true = 2.0 * (np.linalg.norm(centre + velocity * time_s) - radius)
        cubic = 4.0 * np.linalg.norm(velocity) ** 3 * abs(time_s) ** 3 / 25.0
        bound = cubic if isinstance(path, ScatteredPaths) else across**2 * time_s**2 / distance
        assert abs(law_length(path, nowhere, nowhere, time_s) - true) < bound + 1e-7


def test_a_sensor_that_moves_sees_what_moves_towards_it():
    ball = sphere(0.5, 32)
    still = traced(body(ball, (6.0, 1.0, 0.0), velocity=(-7.0, 0.0, 0.0)))
    moving = traced(body(ball, (6.0, 1.0, 0.0)), pose=Pose((0.0, 0.0, 0.0), velocity=(7.0, 0.0, 0.0)))
    np.testing.assert_allclose(still.scattered.rx_velocity, moving.scattered.rx_velocity)
