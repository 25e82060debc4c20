"""Tracks: their curves, and the files that they are read from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datafactory.scenes.poses import Pose
from datafactory.scenes.tracks import Curve, nearest_m, read_track
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


# --- curves ---------------------------------------------------------------------------------------------------------


def test_rows_are_given_back_as_they_were(tmp_path: Path) -> None:
    poses = read_track(written(tmp_path, TEXT)).rows()
    assert [pose.position for pose in poses] == [(0, 0, 0.5), (4, 0, 0.5), (8, 0, 0.5), (8, 8, 0.5)]
    assert [pose.yaw_deg for pose in poses] == [0, 0, 90, 90]
    assert [pose.time_s for pose in poses] == [0, 1, 2, 4]
    assert poses[0].velocity == pytest.approx((4.0, 0.0, 0.0))


def test_uniform_motion_is_exact_at_any_rate() -> None:
    time_s = np.array([0.0, 0.7, 1.0, 2.5])
    curve = Curve(time_s, np.outer(time_s, [3.0, -2.0, 0.5]), np.zeros((4, 3)))
    for pose in curve.resampled(7.0):
        np.testing.assert_allclose(pose.position, pose.time_s * np.array([3.0, -2.0, 0.5]), atol=1e-12)
        np.testing.assert_allclose(pose.velocity, [3.0, -2.0, 0.5], atol=1e-12)


def test_the_velocity_is_the_derivative_of_the_place() -> None:
    curve = circle(9)
    poses = curve.resampled(1000.0)
    place, velocity = np.array([p.position for p in poses]), np.array([p.velocity for p in poses])
    np.testing.assert_allclose((place[2:] - place[:-2]) * 500.0, velocity[1:-1], atol=0.02)


def test_a_bend_sampled_ten_times_a_second_is_a_bend() -> None:
    """At 10 m/s round a radius of 20 m: 2 mm off the circle at most, and 0.05 m/s of velocity."""
    curve = circle(32)
    for pose in curve.resampled(77.0):
        x, y, _ = pose.position
        assert np.hypot(x, y - 20.0) == pytest.approx(20.0, abs=2e-3)
        if 0.2 < pose.time_s < 2.9:  # at the ends there is one neighbour only
            np.testing.assert_allclose(np.linalg.norm(pose.velocity), 10.0, atol=0.05)
            assert pose.yaw_deg == pytest.approx(np.degrees(pose.time_s * 0.5), abs=1e-6)


def test_who_stops_stands_still() -> None:
    x = np.array([0.0, 5.0, 10.0, 10.0, 10.0, 10.0, 15.0, 20.0])
    curve = Curve(np.arange(8.0), np.column_stack([x, 0.0 * x, 0.0 * x]), np.zeros((8, 3)))
    for pose in curve.at(np.linspace(2.0, 5.0, 50)):
        assert pose.position[0] == pytest.approx(10.0, abs=1e-12)
        assert pose.velocity[0] == pytest.approx(0.0, abs=1e-12)


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


def test_how_near_two_tracks_come() -> None:
    one = [Pose((float(x), 0.0, 0.0)) for x in range(10)]
    assert nearest_m(one, [Pose((3.0, 4.0, 0.0)), Pose((20.0, 0.0, 0.0))]) == pytest.approx(4.0)


# --- files ----------------------------------------------------------------------------------------------------------


def test_table_and_list_are_the_same_track(tmp_path: Path) -> None:
    table = "time, x, y, z, yaw_deg, pitch_deg, roll_deg, vx, vy, vz\n0,1,2,3,10,1,2,4,5,6\n\n1,2,3,4,20,2,3,4,5,6\n"
    entries = [
        {"time": n, "position": [1 + n, 2 + n, 3 + n], "yaw_deg": 10 + 10 * n, "pitch_deg": 1 + n, "roll_deg": 2 + n,
         "velocity": [4, 5, 6]}
        for n in (0, 1)
    ]  # fmt: skip
    one = read_track(written(tmp_path, "\ufeff" + table))
    assert one.rows() == read_track(written(tmp_path, json.dumps(entries), "track.json")).rows()
    assert one.velocity is not None
