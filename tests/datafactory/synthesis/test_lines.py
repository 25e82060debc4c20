"""The kernel along Doppler lines, and the sorting that chooses it, against the float64 sum of eq. (1)-(2)."""

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import if_cube, relative_error
from path_tables import radar_of, random_table

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths, cube_of_sorted
from datafactory.synthesis.motion import Recording, centre, left_out, motion_of, reach_m
from datafactory.synthesis.slow_time import FEWEST_TERMS, MANY_TERMS
from datafactory.synthesis.sorting import ORDERS, PathsAlongLines, SortedPaths, line_sets, sorted_paths
from shared.radar import Radar
from shared.radar.arrays import virtual_sensor_256


def moving(count: int, speed: float, limits_m: tuple[float, float], seed: int = 1) -> PathTable:
    """Bounces around, and a quarter as many moving mirror images, all of unit amplitude."""
    return random_table(np.random.default_rng(seed), count, max(1, count // 4), limits_m, 0.0, speed)


def along_lines(paths: PathTable, radar: Radar, tolerance: float, intra_chirp: bool = False) -> int:
    return sorted_paths(paths, Recording(radar, tolerance, intra_chirp)).counts()["paths_along_lines"]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
@pytest.mark.parametrize(
    ("speed", "limits_m", "waveform", "least"),
    [
        (0.5, (0.5, 3.0), {}, 12),
        (10.0, (3.0, 40.0), {}, 14),
        (40.0, (0.5, 60.0), {}, 0),
        (40.0, (20.0, 150.0), {}, 14),
        (40.0, (0.5, 60.0), {"multiplexing": "tdm"}, 0),
        (40.0, (0.5, 60.0), {"residual_video_phase": True}, 0),
    ],
)
def test_cube_keeps_its_tolerance_over_speeds_and_ranges(tolerance, speed, limits_m, waveform, least):
    # 65 samples reach to 10 m: most of the farther echoes are folded.
    radar = radar_of(samples=65, chirps=33, **waveform)
    paths = moving(12, speed, limits_m)
    assert relative_error(cube_of_paths(paths, radar, tolerance), if_cube(paths, radar)) <= tolerance
    # Otherwise the exact kernel alone is judged.
    assert tolerance < 1e-3 or along_lines(paths, radar, tolerance) >= least


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_virtual_sensor_keeps_its_tolerance(tolerance):
    # Four blocks of RX, each with its own Doppler and range.
    radar = radar_of(samples=32, chirps=16)
    paths = moving(4, 5.0, (3.0, 30.0), seed=3)
    sensor = virtual_sensor_256(radar.waveform.carrier_hz)
    cube = cube_of_paths(paths, radar, tolerance, array=sensor)
    assert along_lines(paths, radar.model_copy(update={"array": sensor}), tolerance) > 0
    assert relative_error(cube, if_cube(paths, radar, sensor)) <= tolerance


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("speed", [2.0, 12.0])
def test_motion_within_the_chirp_agrees_with_the_exact_kernel(tolerance, speed):
    radar = radar_of(samples=64, chirps=64)
    paths = moving(40, speed, (1.0, 30.0), seed=4)
    # At 1e-6 a sensor's motion within the chirp sends all that is fast to the exact kernel.
    assert along_lines(paths, radar, tolerance, intra_chirp=True) > 0 or (tolerance < 1e-5 and speed > 10.0)
    exact = cube_of_paths(paths, radar, 1e-9, intra_chirp=True)
    assert relative_error(cube_of_paths(paths, radar, tolerance, intra_chirp=True), exact) <= tolerance


def one_path(distance: float, velocity: tuple[float, float, float] = (-6.0, 9.0, 0.0)) -> PathTable:
    point = distance * np.array([[0.8, 0.6, 0.0]])
    return PathTable(ScatteredPaths.of_points(point, np.array([velocity]), np.ones(1)))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-6])
def test_the_switch_leaves_no_seam(tolerance):
    # The range at which one path changes its kernel, to the last place.
    radar = radar_of(samples=64, chirps=64)
    near, far = 0.4, 300.0
    assert along_lines(one_path(near), radar, tolerance) == 0
    assert along_lines(one_path(far), radar, tolerance) == 1
    while np.nextafter(near, far) < far:
        middle = 0.5 * (near + far)
        near, far = (near, middle) if along_lines(one_path(middle), radar, tolerance) else (middle, far)
    exactly, spread = (cube_of_paths(one_path(distance), radar, tolerance) for distance in (near, far))
    assert relative_error(spread, exactly) < tolerance


def errors_and_bounds(
    distance: float,
    velocity: tuple[float, float, float],
    radar: Radar,
    tolerance: float,
    intra_chirp: bool,
    close: bool,
) -> tuple[list[float], NDArray[np.float64]]:
    """Relative errors of one path's cube with 1, 2 and 3 orders, and their bounds [3] without ``tolerance``."""
    start = 32 * radar.waveform.chirp_interval_s
    centres = centre(radar.array.tx), centre(radar.array.rx)
    reaches = reach_m(radar.array.tx), reach_m(radar.array.rx)
    paths = one_path(distance, velocity)
    recording = Recording(radar, tolerance, intra_chirp)
    out = left_out(motion_of(paths.scattered, centres, start, recording), reaches, recording)
    weights = next(weights for limit, weights in line_sets(recording) if out.extra[0] <= limit)
    exact, nothing = cube_of_paths(paths, radar, 1e-9, intra_chirp=intra_chirp), PathTable(ScatteredPaths.none())
    found, terms = [], MANY_TERMS if close else FEWEST_TERMS
    for orders in range(1, ORDERS + 1):
        alone = SortedPaths(nothing, (PathsAlongLines(weights, orders, paths, close, terms),), nothing)
        found.append(relative_error(cube_of_sorted(alone, recording, 1), exact))
    return found, (out.close if close else out.far)[:, 0]


@pytest.mark.parametrize("intra_chirp", [False, True], ids=["frozen", "within the chirp"])
@pytest.mark.parametrize("multiplexing", ["simultaneous", "tdm"])
def test_every_order_stays_within_its_bound(intra_chirp, multiplexing):
    radar = radar_of(samples=64, chirps=64, array=Radar().array, multiplexing=multiplexing)
    for distance, velocity in ((6.0, (-3.0, 4.0, 0.0)), (9.0, (-6.0, 9.0, 0.0)), (60.0, (10.0, -20.0, 5.0))):
        found, bounds = errors_and_bounds(distance, velocity, radar, 1e-6, intra_chirp, close=True)
        assert all(found <= bounds + 1e-6)
        # The bound is no empty promise: what an order adds is seen.
        assert found[0] > 3.0 * found[1] > 3.0 * found[2]
        assert found[0] > 0.1 * bounds[0]
        # Without the elements' own curvature the third order's error is that curvature's, a tenth of its bound or more.
        found, bounds = errors_and_bounds(distance, velocity, radar, 1e-6, intra_chirp, close=False)
        assert all(found <= bounds + 1e-6)
        assert found[-1] > 0.1 * bounds[-1]


def test_few_of_a_street_at_speed_go_by_chirps():
    # Ranges and angles of the bench's street at 10 m/s: with two separable terms four of ten went by chirps.
    generator = np.random.default_rng(7)
    place, u = generator.uniform(3.0, 85.0, 400), generator.uniform(-0.85, 0.85, 400)
    points = place[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(400)], axis=1)
    paths = PathTable(ScatteredPaths.of_points(points, np.tile([-10.0, 0.0, 0.0], (400, 1)), np.ones(400)))
    radar = radar_of(samples=32, chirps=128, array=Radar().array)
    sorted_ = sorted_paths(paths, Recording(radar, 1e-6, intra_chirp=False))
    assert sorted_.counts()["paths_by_chirps"] < 40
    assert {group.orders for group in sorted_.lines} == {1, 2, 3}
    some = PathTable(paths.scattered.take(np.arange(40)))
    assert relative_error(cube_of_paths(some, radar, 1e-6), if_cube(some, radar)) <= 1e-6


def test_paths_of_every_need_are_counted_once():
    radar = radar_of(samples=64, chirps=64)
    paths = PathTable(
        ScatteredPaths.of_points(
            np.array([[10.0, 0.0, 0.0], [20.0, 1.0, 0.0], [0.3, 0.0, 0.0]]),
            np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 30.0, 0.0]]),
            np.ones(3),
        )
    )
    counts = sorted_paths(paths, Recording(radar, 1e-4, intra_chirp=False)).counts()
    assert counts == {"paths_standing": 1, "paths_along_lines": 1, "paths_by_chirps": 1}
    assert relative_error(cube_of_paths(paths, radar, 1e-4), if_cube(paths, radar)) <= 1e-4


def test_threads_and_turns_do_not_change_the_bytes(monkeypatch):
    radar = radar_of(samples=64, chirps=32, multiplexing="tdm")
    paths = moving(40, 12.0, (2.0, 30.0), seed=6)
    assert along_lines(paths, radar, 1e-4) > 30
    one, again, four = (cube_of_paths(paths, radar, 1e-4, threads=threads) for threads in (1, 1, 4))
    assert one.tobytes() == again.tobytes() == four.tobytes()
    # A grid that does not fit is done in turns: other sums, the same cube.
    monkeypatch.setattr("datafactory.synthesis.frame_lines.GRID_BYTES", 1.0)
    turns = cube_of_paths(paths, radar, 1e-4)
    assert relative_error(turns, one) < 1e-6
