"""The Doppler of a static world: by hand, against the signal model, folded at 20 m/s, and back to the velocity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from shared.radar import Radar, load_radar
from shared.signal.ego_motion import (
    FLOOR_DB,
    EgoMotion,
    StaticWorld,
    estimated_motion,
    folded,
    moving_probability,
    velocity_period_mps,
)

RADAR = Radar()
STEP, PERIOD = RADAR.waveform.velocity_step_mps, velocity_period_mps(RADAR)
U = RADAR.grid.u


def world(motion: EgoMotion, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N] Doppler cells of static echoes, folded, one angle at a time: the derivative of the distance to each."""
    seen = []
    for angle in u:
        place = 20.0 * np.array([math.sqrt(1.0 - angle**2), angle])
        later = place - 1e-4 * np.array([motion.forward_mps, motion.left_mps])
        rate = (np.hypot(*later) - 20.0) / 1e-4
        while rate >= 0.5 * PERIOD:
            rate -= PERIOD
        while rate < -0.5 * PERIOD:
            rate += PERIOD
        seen.append(STEP * round(rate / STEP))
    return np.array(seen)


def test_range_rates_by_hand() -> None:
    """3 m/s forward and 4 m/s to the left: straight ahead the range falls by 3 m/s, at u = 0.6 by 0.8 x 3 + 0.6 x 4."""
    rates = EgoMotion(3.0, 4.0).range_rate(np.array([0.0, 0.6, -0.6, 1.0]))
    np.testing.assert_allclose(rates, [-3.0, -4.8, 0.0, -4.0], atol=1e-12)


def test_a_radar_turned_to_the_left_sees_the_street_come_from_its_right() -> None:
    """At 90 degrees to the left of a car that moves forward the radar moves to its own right."""
    turned = EgoMotion.of_vehicle(10.0, 0.0, math.pi / 2.0)
    assert (turned.forward_mps, turned.left_mps) == pytest.approx((0.0, -10.0))
    # 30 degrees: what lies ahead of the car is at azimuth -30 degrees, and comes nearer at the car's speed.
    assert EgoMotion.of_vehicle(10.0, 0.0, math.pi / 6.0).range_rate(np.array([-0.5]))[0] == pytest.approx(-10.0)


def test_a_pose_turns_the_velocity_into_the_radar_frame() -> None:
    """The radar looks along the world's y (a turn of 90 degrees about z) and moves along x and up: to its right."""
    half = math.sqrt(0.5)
    motion = EgoMotion.of_pose((5.0, 0.0, 1.0), (half, 0.0, 0.0, half))
    assert (motion.forward_mps, motion.left_mps) == pytest.approx((0.0, -5.0))
    # Pitched down by 90 degrees (about y) its x points to the world's -z.
    motion = EgoMotion.of_pose((5.0, 2.0, -3.0), (half, 0.0, half, 0.0))
    assert (motion.forward_mps, motion.left_mps) == pytest.approx((3.0, 2.0))


@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_the_prior_is_largest_where_an_echo_stands_whatever_the_fold(speed: float) -> None:
    """At 20 m/s the default radar's Doppler, +-12 m/s, has turned over."""
    motion = EgoMotion(speed, 0.3 * speed)
    at = np.arange(20, 430, 37)
    weights = StaticWorld(motion, world(motion, U[at]), RADAR).prior(U)
    assert weights.shape == (len(at), len(U))
    assert (weights[np.arange(len(at)), at] > 0.83).all()  # exp(-0.5^2 / (2 x 0.85^2)) is 0.84
    for row, place in enumerate(at):
        off = np.abs(folded(motion.range_rate(U) - motion.range_rate(U[place : place + 1]), PERIOD)) > 4.5 * STEP
        assert weights[row, off].max() == pytest.approx(10.0 ** (FLOOR_DB / 10.0), rel=0.2)


def test_a_row_that_no_angle_explains_says_nothing() -> None:
    standing = StaticWorld(EgoMotion(0.0, 0.0), np.array([0.0, 5.0]), RADAR)
    np.testing.assert_array_equal(standing.prior(U), 1.0)
    driving = StaticWorld(EgoMotion(8.0, 0.0), np.array([[3.0]]), RADAR)
    np.testing.assert_allclose(driving.prior(U), 1.0, atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 3.0, 9.0, 20.0, -14.0])
def test_the_velocity_comes_back_from_detections_among_movers(speed: float) -> None:
    """Six of ten stand, four move at any speed; the error stays within what is stated."""
    generator = np.random.default_rng(4)
    truth = EgoMotion(speed, 0.1 * speed)
    u = generator.uniform(-0.8, 0.8, 150)
    velocity = world(truth, u)
    velocity[90:] = STEP * np.rint(generator.uniform(-0.5, 0.5, 60) * PERIOD / STEP)
    found = estimated_motion(u, velocity, RADAR, 7)
    assert found is not None
    assert found == estimated_motion(u, velocity, RADAR, 7)
    for value, expected, std in zip(
        (found.forward_mps, found.left_mps), (truth.forward_mps, truth.left_mps), found.std_mps, strict=True
    ):
        assert abs(value - expected) < 4.0 * std + 0.01
        assert std < 0.5 * STEP


def test_too_few_that_agree_are_no_estimate() -> None:
    generator = np.random.default_rng(5)
    u = generator.uniform(-0.8, 0.8, 100)
    velocity = generator.uniform(-0.5, 0.5, 100) * PERIOD
    velocity[:15] = world(EgoMotion(6.0, 0.0), u[:15])
    assert estimated_motion(u, velocity, RADAR, 0) is None
    assert estimated_motion(u[:8], world(EgoMotion(6.0, 0.0), u[:8]), RADAR, 0) is None
    assert estimated_motion(np.empty(0), np.empty(0), RADAR, 0) is None


@pytest.mark.parametrize("speed", [0.0, 6.0, 20.0])
def test_what_moves_is_marked_and_what_stands_is_not(speed: float) -> None:
    motion = EgoMotion(speed, 0.0)
    u = np.linspace(-0.7, 0.7, 29)
    error = np.full(29, 1e-3), np.full(29, STEP / math.sqrt(12.0))
    still = moving_probability(motion, RADAR, np.full(29, 40.0), u, world(motion, u), *error)
    walker = moving_probability(motion, RADAR, np.full(29, 40.0), u, world(motion, u) + 1.5, *error)
    assert still.max() < 0.1
    assert walker.min() > 0.9
    # A whole turn of the Doppler axis is no motion.
    turned = moving_probability(motion, RADAR, np.full(29, 40.0), u, world(motion, u) + PERIOD, *error)
    np.testing.assert_allclose(turned, still)


def test_probability_by_hand() -> None:
    """Radar at rest, far away: a velocity within its spread is normal, sigma^2 = (1/12 + 1/4) cells^2."""
    cells = 1.2
    sigma = math.sqrt(1.0 / 12.0 + 0.25) * STEP
    normal = 0.9 * math.exp(-((cells * STEP) ** 2) / (2.0 * sigma**2)) / (math.sqrt(2.0 * math.pi) * sigma)
    expected = (0.1 / PERIOD) / (0.1 / PERIOD + normal)
    column = np.array
    found = moving_probability(
        EgoMotion(0.0, 0.0), RADAR, column([50.0]), column([0.2]), column([cells * STEP]), column([0.0]),
        column([STEP / math.sqrt(12.0)]),
    )  # fmt: skip
    assert found[0] == pytest.approx(expected)


def test_the_period_of_a_tdm_board_is_what_its_elements_resolve() -> None:
    board = load_radar("mmwcas-azimuth")
    assert velocity_period_mps(board) == pytest.approx(9 * board.waveform.velocity_span_mps)
