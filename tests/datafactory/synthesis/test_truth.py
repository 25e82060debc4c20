"""The truth image against the virtual sensor's own cube: Doppler filter and exact matched filter, row by row.

Errors are the largest difference relative to the strongest path's amplitude, which is what its peak reads.
Measured with the seeds below: static -70 to -77 dB, moving -53 to -81 dB. The limit is the range walk's polynomial in
the first case, Doppler's in the second. Nearer and faster the delay's third derivative counts: about -31 dB at 15 m/s
and 1 to 3 m, -44 dB at 30 m/s and 3 to 9 m.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import truth_rows
from path_tables import GRID, truth_radar

from datafactory.paths.table import SPECULAR, PathTable, ScatteredPaths, SpecularPaths
from datafactory.synthesis.truth import truth_moments
from shared.physics.units import amplitude_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import DEFAULT_TERMS, near_field_images, walk_terms

STATIC_DB = -60.0
MOVING_DB = -45.0
COUNT = 6


def points(generator: np.random.Generator, count: int, limits_m: tuple[float, float]) -> NDArray[np.float64]:
    """[count, 3] in the field of view, up to 0.1 rad above and below the array's plane."""
    u = generator.choice(GRID.u[1:], count) + generator.uniform(-0.002, 0.002, count)
    elevation = generator.uniform(-0.1, 0.1, count)
    range_m = generator.uniform(*limits_m, count)
    x, y = np.sqrt(1.0 - u**2) * np.cos(elevation), u * np.cos(elevation)
    return range_m[:, None] * np.stack([x, y, np.sin(elevation)], axis=1)


def scattered(
    generator: np.random.Generator, count: int, limits_m: tuple[float, float], speed: float
) -> ScatteredPaths:
    velocity = generator.uniform(-speed, speed, (count, 3))
    return ScatteredPaths.of_points(points(generator, count, limits_m), velocity, phasors(generator, count))


def phasors(generator: np.random.Generator, count: int) -> NDArray[np.complex128]:
    return np.exp(2j * np.pi * generator.uniform(size=count))


def nearest_cells(paths: ScatteredPaths, radar: Radar) -> NDArray[np.int64]:
    """[R] for each row the Doppler cell of the path nearest in range."""
    waveform = radar.waveform
    tx, rx = (
        point + velocity * waveform.mid_frame_s
        for point, velocity in ((paths.tx_point, paths.tx_velocity), (paths.rx_point, paths.rx_velocity))
    )
    tx_leg, rx_leg = np.linalg.norm(tx, axis=1), np.linalg.norm(rx, axis=1)
    range_m = 0.5 * (tx_leg + rx_leg + paths.between_m + paths.between_rate_mps * waveform.mid_frame_s)
    rate = (tx * paths.tx_velocity).sum(1) / tx_leg + (rx * paths.rx_velocity).sum(1) / rx_leg
    rate = 0.5 * (rate + paths.between_rate_mps)
    nearest = np.abs(waveform.ranges_m[:, None] - range_m).argmin(axis=1)
    cells = np.rint(rate[nearest] / waveform.velocity_step_mps).astype(np.int64)
    return (cells + waveform.chirps // 2) % waveform.chirps


def image_of(paths: PathTable, radar: Radar, cells: NDArray[np.int64]) -> NDArray[np.complex64]:
    """[R, U]"""
    return near_field_images(truth_moments(paths, radar, cells)[None], radar, radar.virtual_sensor)[0]


def error_db(paths: PathTable, radar: Radar, cells: NDArray[np.int64], rows: range) -> float:
    image = image_of(paths, radar, cells)
    difference = np.abs(image[list(rows)] - truth_rows(paths, radar, cells, rows)).max()
    strongest = max(np.abs(kind.amplitude).max(initial=0.0) for kind in (paths.scattered, paths.specular))
    return float(20.0 * np.log10(difference / strongest))


NEAR = ((1.0, 3.0), 64, range(4, 26, 2))
MIDDLE = ((3.0, 9.0), 128, range(16, 66, 4))
FAR = ((25.0, 29.0), 256, range(164, 198, 6))


@pytest.mark.parametrize(
    ("place", "speed", "bound_db"),
    [
        (NEAR, 0.0, STATIC_DB),
        (MIDDLE, 0.0, STATIC_DB),
        (FAR, 0.0, STATIC_DB),
        (NEAR, 5.0, MOVING_DB),
        (MIDDLE, 5.0, MOVING_DB),
        (MIDDLE, 15.0, MOVING_DB),
        (FAR, 15.0, MOVING_DB),
    ],
)
def test_image_agrees_with_the_virtual_sensors_cube(place, speed, bound_db):
    limits_m, samples, rows = place
    radar = truth_radar(samples, rows[-1] + 3, chirps=32 if speed else 4)
    paths = scattered(np.random.default_rng(11), COUNT, limits_m, speed)
    assert error_db(PathTable(paths), radar, nearest_cells(paths, radar), rows) < bound_db


@pytest.mark.parametrize("bins", [3.9, 7.0, 14.0, 30.0])
def test_an_echo_that_crosses_many_range_bins_is_where_it_was(bins):
    """The sweep is developed in bands. Seen in the rows of its ends too, and between."""
    radar = truth_radar(128, 100, chirps=64)
    waveform = radar.waveform.model_copy(update={"chirp_interval_s": 1e-3})
    radar = radar.model_copy(update={"waveform": waveform})
    rate = bins * waveform.range_step_m / (waveform.chirps * waveform.chirp_interval_s)
    place, velocity = np.array([[8.0, 0.1, 0.0], [9.0, -0.3, 0.0]]), np.array([[rate, 0.0, 0.0], [-rate, 0.0, 0.0]])
    paths = ScatteredPaths.of_points(place - velocity * waveform.mid_frame_s, velocity, np.array([1.0, 0.5j]))
    middle = round(float(np.linalg.norm(place[0])) / waveform.range_step_m)
    cells = np.full(waveform.range_bins, nearest_cells(paths.take(np.array([0])), radar)[middle])
    assert error_db(PathTable(paths), radar, cells, range(middle - 16, middle + 17, 4)) < MOVING_DB


@pytest.mark.parametrize(("beside_m", "speed"), [(0.5, 12.0), (0.8, 18.0), (0.3, 20.0)])
def test_what_passes_by_near_is_as_bright_as_it_is(beside_m, speed):
    """Elements see it with Dopplers that differ by cells. The last one's line is 70 cells wide, and only its level is
    right; ten terms around the middle of a block gave 24 dB more."""
    radar, velocity = truth_radar(64, 30, chirps=128), np.array([[0.0, speed, 0.0]])
    place = np.array([[beside_m, 0.05, 0.0]])
    paths = PathTable(ScatteredPaths.of_points(place - velocity * radar.waveform.mid_frame_s, velocity, np.ones(1)))
    cells, rows = nearest_cells(paths.scattered, radar), range(1, 10)
    expected = truth_rows(paths, radar, cells, rows)
    made = image_of(paths, radar, cells)[list(rows)]
    assert amplitude_to_db(np.abs(made).max() / np.abs(expected).max()) == pytest.approx(0.0, abs=1.0)
    if beside_m > 0.3:
        assert amplitude_to_db(np.abs(made - expected).max() / np.abs(expected).max()) < -20.0


@pytest.mark.parametrize("bandwidth_hz", [2e9, 4e9])
def test_a_wide_band_walks_through_more_bins_and_takes_more_terms(bandwidth_hz):
    radar = truth_radar(256, 200, chirps=4)
    waveform = radar.waveform.model_copy(update={"bandwidth_hz": bandwidth_hz})
    radar = radar.model_copy(update={"waveform": waveform})
    u, range_m = np.array([0.2, 0.5, 0.8, -0.84]), 80.0 * waveform.range_step_m
    place = range_m * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(4)], axis=1)
    paths = PathTable(ScatteredPaths.of_points(place, np.zeros((4, 3)), phasors(np.random.default_rng(1), 4)))
    cells = np.full(waveform.range_bins, 2)
    terms = walk_terms(radar, DEFAULT_TERMS)
    image = near_field_images(truth_moments(paths, radar, cells, terms)[None], radar, radar.virtual_sensor)[0]
    rows = range(76, 85, 2)
    error = np.abs(image[list(rows)] - truth_rows(paths, radar, cells, rows)).max()
    assert 20.0 * np.log10(error) < STATIC_DB


def test_cells_that_differ_from_row_to_row_at_random():
    # The Doppler choice is made on noisy input: where nothing echoes, neighbouring rows have any cells.
    generator = np.random.default_rng(13)
    radar = truth_radar(128, 60)
    paths = scattered(generator, 20, (3.0, 8.5), 4.0)
    cells = generator.integers(0, radar.waveform.chirps, radar.waveform.range_bins)
    assert error_db(PathTable(paths), radar, cells, range(18, 60, 4)) < MOVING_DB


@pytest.mark.parametrize(("speed", "bound_db"), [(0.0, STATIC_DB), (8.0, MOVING_DB)])
def test_specular_paths(speed, bound_db):
    generator = np.random.default_rng(14)
    radar = truth_radar(128, 60, chirps=32 if speed else 4)
    normal = points(generator, COUNT, (1.0, 1.0))
    image = 2.0 * points(generator, COUNT, (3.0, 8.0))
    velocity, axes = speed * generator.uniform(-1.0, 1.0, (COUNT, 3)), normal[:, :, None] * normal[:, None, :]
    specular = SpecularPaths.of(
        image, velocity, np.eye(3) - 2.0 * axes, phasors(generator, COUNT), np.zeros(COUNT, dtype=np.int32), SPECULAR
    )
    paths = PathTable(scattered(generator, 2, (3.0, 8.0), speed), specular)
    cells = nearest_cells(specular.as_scattered(np.zeros(3)), radar)
    assert error_db(paths, radar, cells, range(18, 58, 4)) < bound_db


@pytest.mark.parametrize(("speed", "bound_db"), [(0.0, STATIC_DB), (8.0, MOVING_DB)])
def test_multiple_bounces(speed, bound_db):
    generator = np.random.default_rng(15)
    radar = truth_radar(128, 60, chirps=32 if speed else 4)
    at_tx, at_rx = scattered(generator, COUNT, (1.5, 4.0), speed), scattered(generator, COUNT, (1.5, 4.0), speed)
    paths = replace(
        at_tx,
        rx_point=at_rx.rx_point,
        rx_velocity=at_rx.rx_velocity,
        between_m=generator.uniform(3.0, 7.0, COUNT),
        between_rate_mps=speed * generator.uniform(-1.0, 1.0, COUNT),
    )
    assert error_db(PathTable(paths), radar, nearest_cells(paths, radar), range(16, 58, 4)) < bound_db


def test_paths_beyond_the_last_row_leave_their_skirts_alone():
    # Range window skirts reach back a few rows; what lies further leaves nothing, and nothing is written out of bounds.
    radar = truth_radar(128, 40, chirps=4)
    step = radar.waveform.range_step_m
    directions = points(np.random.default_rng(16), 5, (1.0, 1.0))
    position = directions * (step * np.array([39.4, 40.7, 42.0, 60.0, 110.0]))[:, None]
    paths = PathTable(ScatteredPaths.of_points(position, np.zeros((5, 3)), np.ones(5)))
    cells = np.full(40, radar.waveform.chirps // 2)
    assert error_db(paths, radar, cells, range(28, 40, 2)) < STATIC_DB


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_the_range_axis_is_cyclic_as_the_cubes(speed):
    # Echoes in the last range bins reach row 0 across the axis's end; those beyond the unambiguous range fold.
    radar = truth_radar(64, 64, chirps=32 if speed else 4)
    step, generator = radar.waveform.range_step_m, np.random.default_rng(19)
    ahead = points(generator, 5, (1.0, 1.0))
    position = ahead * (step * np.array([60.2, 62.6, 63.5, 66.3, 131.8]))[:, None]
    paths = PathTable(ScatteredPaths.of_points(position, speed * ahead, phasors(generator, 5)))
    cells = np.full(64, radar.waveform.chirps // 2 + round(speed / radar.waveform.velocity_step_mps))
    for rows in range(8), range(56, 64):
        assert error_db(paths, radar, cells, rows) < STATIC_DB


@pytest.mark.parametrize("samples", [12, 15, 24, 25])
def test_a_range_axis_shorter_than_the_skirts(samples):
    # Every cell counts once for every row.
    radar = truth_radar(samples, samples, chirps=4)
    step = radar.waveform.range_step_m
    position = points(np.random.default_rng(20), 3, (1.0, 1.0)) * (step * np.array([7.3, 9.0, 11.4]))[:, None]
    paths = PathTable(ScatteredPaths.of_points(position, np.zeros((3, 3)), np.ones(3)))
    assert error_db(paths, radar, np.full(samples, 2), range(samples)) < STATIC_DB


def test_an_on_grid_target_reads_its_amplitude():
    radar = truth_radar(64, 45)
    u = radar.grid.u[23]
    range_m = 30 * radar.waveform.range_step_m
    position = range_m * np.array([[np.sqrt(1.0 - u**2), u, 0.0]])
    paths = PathTable(ScatteredPaths.of_points(position, np.zeros((1, 3)), np.array([0.3 - 0.4j])))
    image = np.abs(image_of(paths, radar, np.full(45, 16)))
    assert np.unravel_index(image.argmax(), image.shape) == (30, 23)
    assert image.max() == pytest.approx(0.5, rel=1e-3)
    two = AntennaArray(tx_m=line(np.array([0.0, 0.01])), rx_m=line(np.array([0.0])))
    with pytest.raises(ValueError, match="2 TX; expected 1"):
        truth_moments(paths, radar.model_copy(update={"virtual_sensor": two}), np.full(45, 16))
