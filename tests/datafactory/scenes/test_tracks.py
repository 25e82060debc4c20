"""Tracks and their files; drawn drives, which keep their limits, their lane and their distance from traffic."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import STREET
from scipy.spatial.transform import Rotation
from town_scenes import BARE, box, sheet

from datafactory.scenes.boxes import Movers
from datafactory.scenes.drives import (
    ACCELERATION_MPS2,
    CRUISING_SPEEDS,
    LATERAL_MPS2,
    Drives,
    draw_drive,
    lasting_mps,
    parse_drives,
    ride,
)
from datafactory.scenes.ground import CLEARANCE_M, Ground, free_ground
from datafactory.scenes.lanes import Lane
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.tracks import Curve, read_track, track_of
from shared.dataset.folder import SPLITS, Split
from shared.physics.errors import InputError

TEXT = "time,x,y,z,yaw_deg\n0,0,0,0.5,0\n1,4,0,0.5,0\n2,8,0,0.5,90\n4,8,8,0.5,90\n"


def written(folder: Path, text: str, name: str = "track.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def circle(rows: int, radius_m: float = 20.0, speed_mps: float = 10.0) -> Curve:
    """Round a corner of 90 deg."""
    time_s = np.linspace(0.0, np.pi / 2 * radius_m / speed_mps, rows)
    angle = speed_mps / radius_m * time_s
    place = np.column_stack([radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle)), np.full(rows, 0.5)])
    return Curve(time_s, place, np.column_stack([np.degrees(angle), np.zeros((rows, 2))]))


# --- curves -----------------------------------------------------------------------------------------------------------


def test_rows_are_given_back_as_they_were(tmp_path: Path) -> None:
    poses = read_track(written(tmp_path, TEXT)).rows()
    assert [pose.position for pose in poses] == [(0, 0, 0.5), (4, 0, 0.5), (8, 0, 0.5), (8, 8, 0.5)]
    assert [pose.yaw_deg for pose in poses] == [0, 0, 90, 90]
    assert [pose.time_s for pose in poses] == [0, 1, 2, 4]
    assert poses[0].velocity == pytest.approx((4.0, 0.0, 0.0))


def test_a_bend_sampled_ten_times_a_second_is_a_bend() -> None:
    """At 10 m/s round a radius of 20 m: 0.2 mm off the circle at most, and 0.01 m/s of velocity, ends included."""
    curve = circle(32)
    for pose in curve.resampled(77.0):
        x, y, _ = pose.position
        assert np.hypot(x, y - 20.0) == pytest.approx(20.0, abs=2e-4)
        angle = pose.time_s * 0.5
        np.testing.assert_allclose(pose.velocity, 10.0 * np.array([np.cos(angle), np.sin(angle), 0.0]), atol=0.01)
        assert pose.yaw_deg == pytest.approx(np.degrees(angle), abs=1e-6)


def test_who_stops_stands_still() -> None:
    x = np.array([0.0, 5.0, 10.0, 10.0, 10.0, 10.0, 15.0, 20.0])
    curve = Curve(np.arange(8.0), np.column_stack([x, 0.0 * x, 0.0 * x]), np.zeros((8, 3)))
    for pose in curve.at(np.linspace(2.0, 5.0, 50)):
        assert pose.position[0] == pytest.approx(10.0, abs=1e-12)
        assert pose.velocity[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 200.0])
def test_who_sets_out_or_arrives_slowly_drives_one_way_at_any_heading(turn_deg: float) -> None:
    """A parabola through the first three rows would begin at -4 m/s, and lead 0.9 m backwards."""
    ahead = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg)), 0.0])
    x = np.array([0.0, 0.5, 10.0, 20.0])
    for way in (x, 20.0 - x[::-1]):
        curve = Curve(np.arange(4.0), np.outer(way, ahead), np.zeros((4, 3)))
        poses = curve.at(np.linspace(0.0, 3.0, 301))
        assert np.diff([np.array(pose.position) @ ahead for pose in poses]).min() >= -1e-12
        assert min(np.array(pose.velocity) @ ahead for pose in poses) >= -1e-12


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, 0.0), (2.0, 1.0, 0.1)])
@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (3.0, -2.0, 0.5), (0.0, 5.0, 0.0)])
def test_a_constant_acceleration_is_exact_at_any_rate(
    start: tuple[float, float, float], acceleration: tuple[float, float, float]
) -> None:
    time_s, first, second = np.array([0.0, 0.7, 1.0, 2.5, 3.0]), np.array(start), np.array(acceleration)
    place = np.outer(time_s, first) + 0.5 * np.outer(time_s**2, second)
    for pose in Curve(time_s, place, np.zeros((5, 3))).resampled(7.0):
        t = pose.time_s
        np.testing.assert_allclose(pose.position, first * t + 0.5 * second * t**2, atol=1e-12)
        np.testing.assert_allclose(pose.velocity, first + second * t, atol=1e-12)


def test_given_velocities_are_kept_and_the_curve_has_them() -> None:
    velocity = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), np.zeros((2, 3)), velocity)
    assert [pose.velocity for pose in curve.rows()] == [pytest.approx(tuple(row)) for row in velocity]
    one, other = curve.at(np.array([0.5, 0.5 + 1e-6]))
    np.testing.assert_allclose((np.array(other.position) - one.position) * 1e6, one.velocity, atol=1e-4)


def test_the_attitude_turns_the_shorter_way() -> None:
    curve = Curve(np.array([0.0, 1.0]), np.zeros((2, 3)), np.array([[170.0, 0.0, 0.0], [-170.0, 10.0, 4.0]]))
    (middle,) = curve.at(np.array([0.5]))
    ends = [Rotation.from_matrix(pose.rotation()) for pose in curve.rows()]
    half = Rotation.from_matrix(middle.rotation())
    angles = [(half * end.inv()).magnitude() for end in ends]
    assert angles[0] == pytest.approx(angles[1])
    assert sum(angles) == pytest.approx((ends[0] * ends[1].inv()).magnitude())
    assert abs(middle.yaw_deg) > 175.0


@pytest.mark.parametrize(("rate_hz", "count"), [(1.0, 5), (10.0, 41), (0.5, 3), (0.3, 2), (1e-3, 1)])
def test_one_frame_each_period_as_far_as_the_last_row(tmp_path: Path, rate_hz: float, count: int) -> None:
    poses = read_track(written(tmp_path, TEXT)).resampled(rate_hz)
    assert len(poses) == count
    np.testing.assert_allclose([pose.time_s for pose in poses], np.arange(count) / rate_hz)


def test_rates_that_are_none_are_refused() -> None:
    for rate_hz in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(InputError, match=r"--frame-rate: .*; expected 0\.001 to 100000 Hz"):
            circle(4).resampled(rate_hz)
    slow = Curve(np.array([0.0, 1e6]), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"--frame-rate: 10 Hz over 1e\+06 s is 10000001 frames; expected"):
        slow.resampled(10.0)


# --- files ------------------------------------------------------------------------------------------------------------


def test_table_and_list_are_the_same_track(tmp_path: Path) -> None:
    table = "time, x, y, z, yaw_deg, pitch_deg, roll_deg, vx, vy, vz\n0,1,2,3,10,1,2,1,1,1\n\n1,2,3,4,20,2,3,1,1,1\n"
    entries = [
        {"time": n, "position": [1 + n, 2 + n, 3 + n], "yaw_deg": 10 + 10 * n, "pitch_deg": 1 + n, "roll_deg": 2 + n,
         "velocity": [1, 1, 1]}
        for n in (0, 1)
    ]  # fmt: skip
    one = read_track(written(tmp_path, "\ufeff" + table))
    assert one.rows() == read_track(written(tmp_path, json.dumps(entries), "track.json")).rows()
    assert one.velocity is not None


def test_poses_are_the_track_that_they_are_in_a_file(tmp_path: Path) -> None:
    """Without velocities those of their places; one that is given is kept."""
    as_read = read_track(written(tmp_path, TEXT)).rows()
    still = [replace(pose, velocity=(0.0, 0.0, 0.0)) for pose in as_read]
    assert track_of(still, "--trajectory") == as_read
    assert track_of(still[:1], "--trajectory") == (still[0],)
    given = (replace(still[0], velocity=(1.0, 0.0, 0.0)), *still[1:])
    assert track_of(given, "--trajectory") == given
    far = [Pose((0.0, 0.0, 0.5)), Pose((1e6, 0.0, 0.5), time_s=1.0)]
    with pytest.raises(InputError, match=r"--trajectory: pose 1 is reached at 1e\+06 m/s from the pose before"):
        track_of(far, "--trajectory")


@pytest.mark.parametrize("velocity", ["36,0,0", "0,-10,0"])
def test_velocities_that_are_none_of_the_track_are_refused(tmp_path: Path, velocity: str) -> None:
    """In km/h, and along the axes of a sensor that looks aside: frames between the rows would drive backwards."""
    table = "time,x,y,z,yaw_deg,vx,vy,vz\n" + "".join(f"{n},{10 * n},0,0.5,0,{velocity}\n" for n in range(4))
    with pytest.raises(InputError, match=r"m/s where places go at \(10, 0, 0\); expected those of the world, in m/s"):
        read_track(written(tmp_path, table))
    read_track(written(tmp_path, table.replace(velocity, "9,1,0")))


# --- drives -----------------------------------------------------------------------------------------------------------

FINE = Drives(seconds=5.0, rate_hz=100.0)


@pytest.fixture(scope="module")
def shipped() -> tuple[Scene, Ground]:
    scene = open_scene(str(STREET))
    return scene, free_ground(scene)


def corner(radius_m: float) -> Lane:
    """30 m straight on, a quarter of a circle to the left, 30 m straight on."""
    at = np.arange(0.0, 60.0 + math.pi / 2 * radius_m, 0.5)
    turn = np.clip((at - 30.0) / radius_m, 0.0, math.pi / 2)
    heading = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Lane(np.concatenate([[[0.0, 0.0]], np.cumsum(0.5 * heading, axis=0)])[: len(at)])


def test_a_straight_lane_is_driven_at_cruising_speed_until_it_ends() -> None:
    lane = Lane(np.stack([np.arange(0.0, 80.5, 0.5), np.zeros(161)], axis=1))
    way, speed = ride(lane, 10.0).at(np.array([0.0, 1.0, 5.0, 60.0]))
    np.testing.assert_allclose(way, [0.0, 10.0, 50.0, 80.0], atol=1e-9)
    np.testing.assert_allclose(speed, [10.0, 10.0, 10.0, 0.0], atol=1e-9)
    # v^2 / (2 a) = 16.7 m before the end it begins to brake.
    braking, _ = ride(lane, 10.0).at(np.array([(80.0 - 100.0 / 6.0) / 10.0 + 1.0]))
    assert braking[0] == pytest.approx(80.0 - 100.0 / 6.0 + 10.0 - 1.5, abs=0.1)


def test_a_stop_is_reached_stood_at_and_left() -> None:
    lane = Lane(np.stack([np.arange(0.0, 100.5, 0.5), np.zeros(201)], axis=1))
    halted = ride(lane, 6.0, stop=80, standing_s=1.5)
    time_s = np.arange(0.0, 25.0, 0.01)
    way, speed = halted.at(time_s)
    standing = (speed == 0.0) & (way < 99.0)
    assert np.count_nonzero(standing) * 0.01 == pytest.approx(1.5, abs=0.03)
    np.testing.assert_allclose(way[standing], 40.0, atol=1e-6)
    assert way.max() == pytest.approx(100.0)
    np.testing.assert_allclose(np.gradient(way, 0.01)[1:-1], speed[1:-1], atol=0.03)


@pytest.mark.parametrize("radius_m", [8.0, 15.0, 40.0])
def test_bends_are_taken_as_fast_as_they_may_be(radius_m: float) -> None:
    driven = ride(corner(radius_m), 15.0)
    lateral = driven.speed_mps**2 * np.abs(driven.lane.curvature)
    assert lateral.max() <= LATERAL_MPS2 * 1.001
    assert lateral.max() > 0.95 * LATERAL_MPS2  # and no slower
    along = np.diff(driven.speed_mps**2) / (2.0 * np.diff(driven.lane.distance_m))
    assert np.abs(along).max() <= ACCELERATION_MPS2 * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("split", SPLITS)
def test_drawn_drives_keep_their_limits_and_the_free_ground(street: Ground, split: Split, seed: int) -> None:
    poses = draw_drive(street, Movers(BARE), split, FINE, np.random.default_rng(seed))
    assert len(poses) == 500
    time_s, place, velocity = (np.array([getattr(p, n) for p in poses]) for n in ("time_s", "position", "velocity"))
    np.testing.assert_allclose(np.diff(time_s), 0.01, rtol=1e-9)
    speed = np.linalg.norm(velocity, axis=1)
    assert speed.max() <= CRUISING_SPEEDS[1] + 0.05
    moving = speed > 0.5
    rate = np.gradient(speed, 0.01)
    assert np.abs(rate).max() <= ACCELERATION_MPS2 * 1.05
    lateral = np.linalg.norm(np.cross(velocity, np.gradient(velocity, 0.01, axis=0)), axis=1) / np.maximum(speed, 0.5)
    assert lateral[moving].max(initial=0.0) <= LATERAL_MPS2 * 1.1
    i, j = street.cell_of(place[:, 0], place[:, 1])
    assert np.all(street.free[i, j])
    assert np.all(street.region[i, j] == SPLITS.index(split))


def test_the_velocity_of_a_drive_is_the_derivative_of_its_place(street: Ground) -> None:
    poses = draw_drive(
        street, Movers(BARE), "train", replace(FINE, rate_hz=1000.0, seconds=1.0), np.random.default_rng(1)
    )
    place, velocity = np.array([p.position for p in poses]), np.array([p.velocity for p in poses])
    difference = (place[2:] - place[:-2]) / 0.002
    np.testing.assert_allclose(difference, velocity[1:-1], atol=2e-3)


def test_the_sensor_looks_along_its_way_half_a_metre_above_the_ground(street: Ground) -> None:
    for pose in draw_drive(street, Movers(BARE), "train", Drives(speed_mps=8.0), np.random.default_rng(2)):
        vx, vy, _ = pose.velocity
        if math.hypot(vx, vy) > 0.1:
            assert math.degrees(math.atan2(vy, vx)) == pytest.approx(pose.yaw_deg, abs=1e-6)
        assert pose.position[2] == pytest.approx(0.5, abs=1e-9)
        assert pose.pitch_deg == pytest.approx(0.0, abs=1e-6)


def test_uphill_the_sensor_looks_up_with_the_road() -> None:
    hill = sheet("hill", (-110.0, 110.0), (-30.0, 30.0), lambda x, y: 0.1 * x)
    houses = [box(f"house{side}", (-110.0, 12.0 * side - 1, -20.0), (110.0, 12.0 * side + 1, 30.0)) for side in (-1, 1)]
    scene = Scene("hill", (hill, *houses))
    ground = free_ground(scene)
    pose = draw_drive(ground, Movers(scene), "train", Drives(speed_mps=5.0), np.random.default_rng(0))[10]
    boresight, velocity = pose.rotation()[:, 0], np.array(pose.velocity)
    np.testing.assert_allclose(boresight, velocity / np.linalg.norm(velocity), atol=1e-3)
    rise = 0.1 * math.cos(math.radians(pose.yaw_deg))
    assert boresight[2] == pytest.approx(rise / math.hypot(1.0, rise), abs=1e-3)
    assert abs(rise) > 0.05


def test_a_lane_that_is_short_is_driven_as_fast_as_it_lasts() -> None:
    """10 m/s for 2 s and v^2 / (2 a) to stop in."""
    assert lasting_mps(20.0 + 100.0 / 6.0, 2.0) == pytest.approx(10.0)
    lane = Lane(np.stack([np.arange(0.0, 37.0, 0.5), np.zeros(74)], axis=1))
    _, speed = ride(lane, lasting_mps(lane.length_m, 2.0)).at(np.arange(0.0, 2.0, 0.1))
    np.testing.assert_allclose(speed, lasting_mps(lane.length_m, 2.0), rtol=1e-9)


def test_drives_go_as_fast_as_asked_but_for_bends_and_stops(street: Ground) -> None:
    drives = [
        draw_drive(street, Movers(BARE), "train", Drives(speed_mps=9.0), np.random.default_rng(seed))
        for seed in range(10)
    ]
    first, last = (np.array([np.linalg.norm(poses[at].velocity) for poses in drives]) for at in (0, -1))
    assert np.count_nonzero(np.isclose(first, 9.0, atol=0.05)) >= 8
    assert np.count_nonzero(np.isclose(last, 9.0, atol=0.05)) >= 5  # three of ten stop on their way


def test_most_drives_keep_to_the_roads(street: Ground) -> None:
    """The half of the town that is called a road, of a region that is all of it."""
    x = street.origin[0] + (np.indices(street.free.shape)[0] + 0.5) * street.cell_m
    whole = replace(street, region=np.zeros_like(street.region))

    def west(ground: Ground) -> int:
        rngs = map(np.random.default_rng, range(20))
        drives = [draw_drive(ground, Movers(BARE), "train", Drives(speed_mps=4.0), rng) for rng in rngs]
        return sum(poses[0].position[0] < 0.0 for poses in drives)

    assert west(whole) < 18 <= west(replace(whole, road=street.free & (x < 0.0)))


def test_a_drive_at_no_speed_stands(street: Ground) -> None:
    poses = draw_drive(street, Movers(BARE), "train", Drives(speed_mps=0.0), np.random.default_rng(3))
    assert {pose.position for pose in poses} == {poses[0].position}
    assert all(pose.velocity == (0.0, 0.0, 0.0) for pose in poses)


@pytest.mark.parametrize("seed", range(4))
def test_drives_keep_clear_of_traffic(shipped: tuple[Scene, Ground], seed: int) -> None:
    """Against every vertex of what moves, at every pose's time."""
    scene, ground = shipped
    for pose in draw_drive(
        ground, Movers(scene), "train", Drives(seconds=3.0, rate_hz=4.0), np.random.default_rng(seed)
    ):
        for item in scene.objects:
            if item.moves:
                vertices = item.at(pose.time_s).vertices - np.asarray(pose.position)
                assert np.linalg.norm(vertices, axis=1).min() >= CLEARANCE_M, item.name


def test_movers_are_where_their_vertices_are(shipped: tuple[Scene, Ground]) -> None:
    scene, _ = shipped
    movers = Movers(scene)
    assert movers
    assert not Movers(BARE)
    for time_s in (0.0, 1.7):
        boxes = movers.boxes(time_s)
        moving = [item for item in scene.objects if item.moves]
        found = {tuple(np.round(np.concatenate(box), 6)) for box in boxes}
        for item in moving:
            vertices = item.at(time_s).vertices
            assert tuple(np.round(np.concatenate([vertices.min(axis=0), vertices.max(axis=0)]), 6)) in found


def test_no_street_is_said_in_one_line(street: Ground) -> None:
    none = replace(street, region=np.full_like(street.region, -1))
    with pytest.raises(
        InputError, match=r"town: no drive in the region of test: no street is long enough; expected .*"
    ):
        draw_drive(none, Movers(BARE), "test", Drives(), np.random.default_rng(0))


def test_what_is_asked_of_drives_is_read() -> None:
    assert parse_drives("drive", None) == Drives()
    assert parse_drives("drive:speed=10,seconds=4", 20.0) == Drives(10.0, 4.0, 20.0)
    assert Drives(seconds=0.3, rate_hz=10.0).frames == 3
