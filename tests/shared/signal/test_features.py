"""Features, eq. (7)-(12) in float64, in NumPy and torch; the Doppler of a static world, and back to the velocity."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import ImageGrid, Radar, load_radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.radar.waveform import Waveform
from shared.signal.adaptive import adaptive_tables
from shared.signal.ego_motion import (
    FLOOR_DB,
    EgoMotion,
    StaticWorld,
    estimated_motion,
    folded,
    moving_probability,
    velocity_period_mps,
)
from shared.signal.features import (
    MAGNITUDE_FLOOR_DB,
    adaptive_features,
    covariance_channels,
    paper_features,
    row_features,
    snapshot_features,
)
from shared.signal.imaging import steering_weights
from shared.signal.model_error import NO_MODEL_ERROR_DB, UNCALIBRATED_DB, model_error_ratio, row_noise

RADAR = Radar(waveform=Waveform(samples=16, chirps=2, range_bins=5), grid=ImageGrid(bins=450))
ARRAYS = sorted(AVR_QDM_110_THINNED_RX)


def snapshots(generator, channels, rows=5):
    """[rows, C] of amplitudes 80 dB apart, like an image's near and far rows [sqrt(W)]."""
    values = generator.standard_normal((rows, channels, 2)) * np.geomspace(1e-4, 1e-8, rows)[:, None, None]
    return (values[..., 0] + 1j * values[..., 1]).astype(np.complex64)


def slow_reference(snapshot, radar, channels):
    """[5, R, U] the paper's features by loops in float64; sign of the steering as in design conventions (+u)."""
    y = radar.array.virtual[channels, 1]
    wavenumber = 2 * np.pi / radar.waveform.wavelength_m
    rows, bins = len(snapshot), radar.grid.bins
    image = np.zeros((rows, bins), complex)
    covariance = np.zeros((rows, bins), complex)
    for r in range(rows):
        s = snapshot[r].astype(complex)
        for j, u in enumerate(radar.grid.u):
            image[r, j] = sum(s[c] * np.exp(1j * wavenumber * u * y[c]) for c in range(len(s))) / len(s)
        matrix = np.outer(s, s.conj())
        matrix = (matrix / np.linalg.norm(matrix))[:29, :29]
        place = 0
        for row in range(len(matrix)):
            for column in range(row, len(matrix)):
                covariance[r, place] = matrix[row, column]
                place += 1
    level = np.log10(np.maximum(np.abs(image) / np.abs(image).max(), 10 ** (MAGNITUDE_FLOOR_DB / 20)))
    level = (level - level.min()) / (level.max() - level.min())
    return np.stack([level, np.angle(image), covariance.real, covariance.imag, np.angle(covariance)])


def wrapped(phase):
    return np.abs(np.exp(1j * phase) - 1)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_paper_s_channels_equal_the_slow_reference_for_every_array(generator, name):
    channels = RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])
    data = snapshots(generator, len(channels))
    expected = slow_reference(data, RADAR, channels)
    found = paper_features(data, steering_weights(RADAR, channels))
    assert found.shape == (5, 5, 450)
    assert found.dtype == np.float32
    for channel in (0, 2, 3):
        np.testing.assert_allclose(found[channel], expected[channel], atol=2e-5)
    # Phases are compared where the value is not within rounding of zero, and on the circle.
    strong = expected[0] > 0.5
    assert wrapped(found[1] - expected[1])[strong].max() < 1e-3
    filled = np.abs(expected[2] + 1j * expected[3]) > 1e-5
    assert wrapped(found[4] - expected[4])[filled].max() < 1e-3


@pytest.mark.parametrize("name", ARRAYS)
def test_torch_gives_what_numpy_gives_and_a_batch_what_single_frames_give(generator, name):
    channels = RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])
    weights = steering_weights(RADAR, channels)
    data = np.stack([snapshots(generator, len(channels)) for _ in range(2)])
    noise = np.array([1e-16, 0.0])
    tensors = torch.from_numpy(data), torch.from_numpy(weights), torch.from_numpy(noise)
    paper, (rows, scale) = paper_features(data, weights), row_features(data, weights, noise)
    torch_paper, (torch_rows, torch_scale) = paper_features(*tensors[:2]), row_features(*tensors)
    for channel in (0, 2, 3):
        np.testing.assert_allclose(torch_paper[:, channel], paper[:, channel], atol=2e-5)
    np.testing.assert_allclose(torch_rows, rows, atol=2e-5)
    np.testing.assert_allclose(torch_scale, scale, rtol=1e-5)
    assert torch_rows.dtype == torch.float32
    assert rows.dtype == np.float32
    np.testing.assert_allclose(row_features(data[1], weights, noise[1])[0], rows[1], atol=2e-5)


def test_a_single_echo_reads_one_at_its_place():
    weights = steering_weights(RADAR, np.arange(48))
    echo = np.conj(weights[:, 300] * 48)[None] * np.complex64(3e-7 * np.exp(2j))
    features, scale = row_features(echo, weights, np.array(1e-17))
    assert scale[0] == pytest.approx(3e-7, rel=1e-5)
    assert features[2, 0].argmax() == 300
    np.testing.assert_allclose(features[:3, 0, 300], [1, 0, 1], atol=1e-5)
    # log10(9e-14 / 1e-17) = 3.954 on the scale from -2 to 8
    assert features[3, 0, 0] == pytest.approx((np.log10(9e-14 / 1e-17) + 2) / 10, abs=1e-5)


def test_the_whole_covariance_equals_eq_13(generator):
    data = snapshots(generator, 12)
    found = covariance_channels(data)
    assert found.shape == (3, 5, 144)
    for row, s in enumerate(data.astype(complex)):
        matrix = np.outer(s, s.conj())
        matrix /= np.linalg.norm(matrix)
        np.testing.assert_allclose(found[0, row] + 1j * found[1, row], matrix.ravel(), atol=1e-6)
        assert wrapped(found[2, row] - np.angle(matrix.ravel())).max() < 1e-2
    np.testing.assert_allclose(covariance_channels(torch.from_numpy(data))[:2], found[:2], atol=1e-6)


SMALL = Radar(grid=ImageGrid(bins=90))
CHANNELS = np.arange(12)
WEIGHTS = steering_weights(SMALL, CHANNELS)
TABLES = adaptive_tables(SMALL, CHANNELS)


def rows(generator, shape=(2, 3)):
    """[..., R, 12] rows 30 dB apart [sqrt(W)]."""
    values = generator.standard_normal((*shape, 12, 2)) @ np.array([1.0, 1.0j])
    return (values * np.array([1e-4, 3e-6, 1e-7])[:, None]).astype(np.complex64)


def test_the_noise_of_a_row_is_the_receiver_s_and_a_share_of_its_power(generator):
    data = rows(generator)[0]
    expected = [1e-12 + 0.01 * sum(abs(complex(x)) ** 2 for x in row) / 12 for row in data]
    np.testing.assert_allclose(row_noise(data, 1e-12, -20.0), expected, rtol=1e-6)
    assert row_noise(data, 1e-12, NO_MODEL_ERROR_DB).tolist() == [1e-12] * 3
    assert model_error_ratio(UNCALIBRATED_DB) == pytest.approx(10**-2.5)


@pytest.mark.parametrize("level", [0.1, np.nan, np.inf])
def test_a_model_error_above_the_row_s_power_is_refused(level):
    with pytest.raises(InputError, match=r"^model_error_db: .*; expected at most 0 dB of the row"):
        model_error_ratio(level)


@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy])
def test_a_network_is_told_the_sum_of_both(generator, library):
    data, noise = rows(generator), np.array([1e-14, 1e-18])
    error = np.array([10**-2.5, 0.0])
    given = library(data), library(noise)
    planes, scale = (np.asarray(values) for values in snapshot_features(*given, library(error)))
    expected = noise[:, None] / scale.astype(float) ** 2 + error[:, None]
    np.testing.assert_allclose(planes[:, 24, :, 0], expected, rtol=1e-5)
    level = np.asarray(row_features(given[0], library(WEIGHTS), given[1], library(error))[0])[:, 3, :, 0]
    np.testing.assert_allclose(10.0 ** -(10.0 * level - 2.0), np.clip(expected, 1e-8, 1e2), rtol=1e-3)
    tables = type(TABLES)(*(library(table) for table in TABLES))
    mixed = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5, library(error))[0])
    floor = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5, 10**-2.5)[0])
    none = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5)[0])
    np.testing.assert_allclose(mixed[0], floor[0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(mixed[1], none[1], rtol=1e-3, atol=1e-4)
    assert np.abs(mixed[0] - none[0]).max() > 0.01


WHOLE = Radar()
STEP, PERIOD = WHOLE.waveform.velocity_step_mps, velocity_period_mps(WHOLE)
U = WHOLE.grid.u


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
    weights = StaticWorld(motion, world(motion, U[at]), WHOLE).prior(U)
    assert weights.shape == (len(at), len(U))
    assert (weights[np.arange(len(at)), at] > 0.83).all()  # exp(-0.5^2 / (2 x 0.85^2)) is 0.84
    for row, place in enumerate(at):
        off = np.abs(folded(motion.range_rate(U) - motion.range_rate(U[place : place + 1]), PERIOD)) > 4.5 * STEP
        assert weights[row, off].max() == pytest.approx(10.0 ** (FLOOR_DB / 10.0), rel=0.2)


def test_a_row_that_no_angle_explains_says_nothing() -> None:
    standing = StaticWorld(EgoMotion(0.0, 0.0), np.array([0.0, 5.0]), WHOLE)
    np.testing.assert_array_equal(standing.prior(U), 1.0)
    driving = StaticWorld(EgoMotion(8.0, 0.0), np.array([[3.0]]), WHOLE)
    np.testing.assert_allclose(driving.prior(U), 1.0, atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 3.0, 9.0, 20.0, -14.0])
def test_the_velocity_comes_back_from_detections_among_movers(speed: float) -> None:
    """Six of ten stand, four move at any speed; the error stays within what is stated."""
    generator = np.random.default_rng(4)
    truth = EgoMotion(speed, 0.1 * speed)
    u = generator.uniform(-0.8, 0.8, 150)
    velocity = world(truth, u)
    velocity[90:] = STEP * np.rint(generator.uniform(-0.5, 0.5, 60) * PERIOD / STEP)
    found = estimated_motion(u, velocity, WHOLE, 7)
    assert found is not None
    assert found == estimated_motion(u, velocity, WHOLE, 7)
    for value, expected, std in zip(
        (found.forward_mps, found.left_mps), (truth.forward_mps, truth.left_mps), found.std_mps, strict=True
    ):
        assert abs(value - expected) < 4.0 * std + 0.01
        assert 0.0 < std < 0.5 * STEP


def test_what_shares_a_doppler_cell_errs_together() -> None:
    """Each target in three range bins, every velocity its cell's centre: the errors stay within what is stated."""
    z = []
    for seed in range(60):
        generator = np.random.default_rng(seed)
        truth = EgoMotion(generator.uniform(5.0, 11.0), generator.uniform(-2.0, 2.0))
        u = np.repeat(generator.uniform(-0.7, 0.7, 40), 3)
        found = estimated_motion(u, STEP * np.rint(truth.range_rate(u) / STEP), WHOLE, seed)
        assert found is not None
        away = found.forward_mps - truth.forward_mps, found.left_mps - truth.left_mps
        z.append(np.array(away) / np.array(found.std_mps))
    assert (np.sqrt(np.mean(np.square(z), axis=0)) < 1.1).all()


def test_too_few_that_agree_are_no_estimate() -> None:
    generator = np.random.default_rng(5)
    u = generator.uniform(-0.8, 0.8, 100)
    velocity = generator.uniform(-0.5, 0.5, 100) * PERIOD
    velocity[:15] = world(EgoMotion(6.0, 0.0), u[:15])
    assert estimated_motion(u, velocity, WHOLE, 0) is None
    assert estimated_motion(u[:8], world(EgoMotion(6.0, 0.0), u[:8]), WHOLE, 0) is None
    assert estimated_motion(np.empty(0), np.empty(0), WHOLE, 0) is None


@pytest.mark.parametrize("chirps", [8, 16, 32])
def test_velocities_that_agree_by_chance_are_no_estimate(chirps: int) -> None:
    """With few Doppler cells, a third of drawn velocities agree with one of thousands of proposals."""
    waveform = WHOLE.waveform.model_copy(update={"chirps": chirps})
    radar = WHOLE.model_copy(update={"waveform": waveform})
    period, step = velocity_period_mps(radar), waveform.velocity_step_mps
    for count in (12, 20, 40, 100):
        for seed in range(10):
            generator = np.random.default_rng(seed)
            u = generator.uniform(-0.8, 0.8, count)
            velocity = step * np.rint(generator.uniform(-0.5, 0.5, count) * period / step)
            assert estimated_motion(u, velocity, radar, seed) is None


@pytest.mark.parametrize("speed", [0.0, 6.0, 20.0])
def test_what_moves_is_marked_and_what_stands_is_not(speed: float) -> None:
    motion = EgoMotion(speed, 0.0)
    u = np.linspace(-0.7, 0.7, 29)
    error = np.full(29, 1e-3), np.full(29, STEP / math.sqrt(12.0)), np.full(29, 0.99)
    still = moving_probability(motion, WHOLE, np.full(29, 40.0), u, world(motion, u), *error)
    walker = moving_probability(motion, WHOLE, np.full(29, 40.0), u, world(motion, u) + 1.5, *error)
    assert still.max() < 0.1
    assert walker.min() > 0.9
    # A whole turn of the Doppler axis is no motion.
    turned = moving_probability(motion, WHOLE, np.full(29, 40.0), u, world(motion, u) + PERIOD, *error)
    np.testing.assert_allclose(turned, still)


@pytest.mark.parametrize("echo", [0.5, 0.95, 0.99])
def test_probability_by_hand(echo: float) -> None:
    """Radar at rest, far away: a velocity within its spread is normal, sigma^2 = (1/12 + 1/4) cells^2."""
    cells = 1.2
    sigma = math.sqrt(1.0 / 12.0 + 0.25) * STEP
    normal = 0.7 * math.exp(-((cells * STEP) ** 2) / (2.0 * sigma**2)) / (math.sqrt(2.0 * math.pi) * sigma)
    odds = (echo / (1.0 - echo) / 16.0) ** 2
    expected = odds / (1.0 + odds) * (0.3 / PERIOD) / (0.3 / PERIOD + normal)
    column = np.array
    found = moving_probability(
        EgoMotion(0.0, 0.0), WHOLE, column([50.0]), column([0.2]), column([cells * STEP]), column([0.0]),
        column([STEP / math.sqrt(12.0)]), column([echo]),
    )  # fmt: skip
    assert found[0] == pytest.approx(expected)


def test_the_period_of_a_tdm_board_is_what_its_elements_resolve() -> None:
    board = load_radar("mmwcas-azimuth")
    assert velocity_period_mps(board) == pytest.approx(9 * board.waveform.velocity_span_mps)
