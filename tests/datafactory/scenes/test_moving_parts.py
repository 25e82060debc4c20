"""Parts that move by themselves: rolling wheels and the walker against kinematics, differences and its source."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from usd_files import read

from datafactory.frame.points import read_targets
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.bodies import Motion, MovingParts
from datafactory.scenes.targets.models import POINTS, Car, Cyclist, Pedestrian, options_of, rolling_wheels, target_model
from datafactory.scenes.targets.walking import (
    PARTS,
    control_points,
    cycle_s,
    ellipsoid_rcs_m2,
    joints,
    leg_m,
    parts_of_walker,
)
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.signal.spectrum import range_doppler

RADIUS_M = 0.32
HUBS = np.array([[1.4, 0.8, RADIUS_M], [-1.4, 0.8, RADIUS_M]])
ONE = np.ones(2)


def test_the_rim_rolls_without_slip() -> None:
    """Velocities are differences of places, 0 where the wheel touches the ground and 2 v at the top."""
    speed, step = 9.0, 1e-6
    before, now, after = (rolling_wheels(HUBS, RADIUS_M, ONE, Motion(speed, 0.7 + t, 5)) for t in (-step, 0.0, step))
    np.testing.assert_allclose(now.velocity, (after.position - before.position) / (2.0 * step), atol=1e-5)
    over_ground = now.velocity + np.array([speed, 0.0, 0.0])
    height = now.position[:, 2] / (2.0 * RADIUS_M)
    np.testing.assert_allclose(np.linalg.norm(over_ground, axis=1), 2.0 * speed * np.sqrt(height), atol=1e-9)
    np.testing.assert_allclose(over_ground[:, 0], 2.0 * speed * height, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(now.position - np.repeat(HUBS, POINTS, axis=0), axis=1), RADIUS_M)


def spectrum_of(tmp_path: Path, *entries: dict[str, object], seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Velocity axis [m/s] and power over it of what a file of targets gives, summed over range and channels."""
    file = tmp_path / "targets.json"
    file.write_text(json.dumps([list(entries)]))
    (targets,) = read_targets(file)
    full = Radar()
    waveform = full.waveform.model_copy(update={"samples": 256, "range_bins": 256})
    radar = full.model_copy(update={"waveform": waveform})
    spectra = range_doppler(cube_of_paths(targets.echo_points(radar, seed).path_table(radar), radar, 1e-4), radar)
    return waveform.velocities_mps, (np.abs(spectra) ** 2).sum(axis=(0, 2))


def test_the_spectrum_of_a_wheel_reaches_from_rest_to_twice_the_speed(tmp_path: Path) -> None:
    """A bicycle that drives away along the line of sight: support 0 to 2 v, mean v."""
    speed = 4.0
    entry = {"x": 20.0, "y": 0.0, "vx": speed, "model": "cyclist", "wheel_radius_m": 0.35}
    velocity, power = spectrum_of(tmp_path, entry)
    cell = float(velocity[1] - velocity[0])
    within = (velocity > -2.0 * cell) & (velocity < 2.0 * speed + 2.0 * cell)
    assert power[~within].sum() / power.sum() < 1e-4
    rising = np.cumsum(power) / power.sum()
    lowest, highest = np.interp([0.02, 0.98], rising, velocity)
    assert lowest < 0.15 * speed
    assert highest > 1.85 * speed
    # Of each wheel 24 points at random angles: their mean is off by v / sqrt(2 x 48), over six seeds by 0.04 v.
    means = [np.average(velocity, weights=spectrum_of(tmp_path, entry, seed=seed)[1]) for seed in range(6)]
    assert np.mean(means) == pytest.approx(speed, abs=0.12 * speed)
    rigid = spectrum_of(tmp_path, {**{k: v for k, v in entry.items() if k != "wheel_radius_m"}})
    spread = [np.sqrt((p * (v - speed) ** 2).sum() / p.sum()) for v, p in ((velocity, power), rigid)]
    assert spread[1] < cell
    assert spread[0] > 0.4 * speed


def test_what_is_low_is_hidden() -> None:
    parts = rolling_wheels(HUBS, RADIUS_M, ONE, Motion(9.0, 0.1, 5), hidden_below_m=0.2)
    assert ((parts.position[:, 2] < 0.2) == (parts.rcs_m2 == 0.0)).all()
    assert 0 < (parts.rcs_m2 == 0.0).sum() < len(parts.rcs_m2) / 2


@pytest.mark.parametrize(("radar", "heard"), [((15.0, 0.0, 0.5), (0, 1)), ((-15.0, 0.5, 0.5), (2, 3)),
                                              ((2.0, 9.0, 0.5), (0, 2)), ((2.0, -9.0, 0.5), (1, 3))])  # fmt: skip
def test_a_car_shows_the_wheels_on_the_radars_side(radar: tuple[float, float, float], heard: tuple[int, int]) -> None:
    parts = Car(RADIUS_M).parts(np.array(radar), Motion(9.0))
    level = parts.rcs_m2.reshape(4, POINTS).sum(axis=1)
    assert tuple(np.flatnonzero(level)) == heard
    np.testing.assert_allclose(level[list(heard)], 0.1)


def test_a_bicycles_wheels_keep_its_level() -> None:
    radar = np.array([3.0, 12.0, 0.5])
    rigid = Cyclist().echoes(radar, 4e-3)[1].sum()
    turning = Cyclist(0.35)
    assert turning.echoes(radar, 4e-3)[1].sum() + turning.parts(radar, Motion(5.0)).rcs_m2.sum() == pytest.approx(rigid)


def test_options_are_off_unless_stated() -> None:
    assert [repr(model) for model in (Car(), Cyclist(), Pedestrian())] == ["Car()", "Cyclist()", "Pedestrian()"]
    assert target_model("car", {"wheel_radius_m": 0.3}) == Car(0.3)
    assert set(options_of("car")) == {"wheel_radius_m", "wheel_hidden_below_m"}


def test_a_scene_states_options_as_attributes(tmp_path: Path) -> None:
    scene = read(
        tmp_path,
        """def Xform "car" {
            custom string radar:target = "car"
            custom double radar:wheel_radius_m = 0.31
            custom double3 radar:velocity = (8, 0, 0)
        }
        def Xform "walker" {
            custom string radar:target = "pedestrian"
            custom float radar:stature_m = 1.75
            custom float radar:gait_phase = 0.25
            custom double3 radar:velocity = (1.4, 0, 0)
        }""",
    )
    assert [target.model for target in scene.targets] == [Car(0.31), Pedestrian(1.75, 0.25)]
    stated = [replace(target, model=Pedestrian()) for target in scene.targets]
    assert replace(scene, targets=tuple(stated)).content_hash() != scene.content_hash()


def test_a_file_of_targets_may_name_models(tmp_path: Path) -> None:
    entries = [
        {"x": 9.0, "y": 1.0, "z": -0.5, "vx": -1.2, "vy": 0.5, "model": "pedestrian", "stature_m": 1.75},
        {"x": 5.0, "y": 0.0, "rcs_dbsm": 3.0},
        {"x": 20.0, "y": 0.0, "model": "trihedral", "edge_m": 0.1, "heading_deg": 180},
    ]
    (tmp_path / "targets.json").write_text(json.dumps([entries]))
    (targets,) = read_targets(tmp_path / "targets.json")
    assert len(targets.position) == 1
    human, corner = targets.models
    assert isinstance(human, PointTarget)
    np.testing.assert_allclose(human.axes[0], [-12.0 / 13.0, 5.0 / 13.0, 0.0])
    radar = Radar()
    placed = targets.echo_points(radar, 7)
    assert len(placed.position) == 1 + 16 + 1
    assert placed.position.tobytes() == targets.echo_points(radar, 7).position.tobytes()
    assert placed.position.tobytes() != targets.echo_points(radar, 8).position.tobytes()
    assert len(placed.truth(radar)) == 18
    assert corner.axes[0][0] == -1.0


STATURE_M = 1.75
RADAR = np.array([12.0, 3.0, 0.5])
FRAME_S = 128 * 80.6e-6
NAMES = [part.name for part in PARTS]
TORSO = NAMES.index("torso")


def walker(speed: float, time_s: float, start: float = 0.0, radar: NDArray = RADAR) -> MovingParts:
    return parts_of_walker(radar, Motion(speed, time_s), STATURE_M, 0.73, start)


@pytest.mark.parametrize("speed", [0.3, 0.9, 1.4, 2.4])
def test_velocities_are_the_differences_of_places(speed: float) -> None:
    """Of every part at 40 phases, against central differences; their error is of second order in the step."""
    step = 1e-5
    for time_s in np.linspace(0.013, 0.013 + cycle_s(speed, STATURE_M), 40, endpoint=False):
        before, now, after = (walker(speed, time_s + t) for t in (-step, 0.0, step))
        slope = (after.position - before.position) / (2.0 * step)
        # A control point within the step leaves a kink in the velocity: accelerations stay below 100 m/s^2.
        np.testing.assert_allclose(now.velocity, slope, atol=100.0 * step)


@pytest.mark.parametrize("speed", [0.3, 0.9, 1.4, 2.4])
def test_the_torso_moves_with_the_given_velocity(speed: float) -> None:
    """Over a cycle exactly; within it, it sways by what the source says: 2 pi 2 a_f / T_c, and the back's lean."""
    times = np.linspace(0.0, cycle_s(speed, STATURE_M), 200, endpoint=False)
    velocity = np.array([walker(speed, t).velocity for t in times])
    np.testing.assert_allclose(velocity.mean(axis=0), 0.0, atol=1e-3 * max(speed, 1.0))
    sway = 4.0 * np.pi / cycle_s(speed, STATURE_M) * (0.021 + np.radians(2.0) * 0.288 * STATURE_M / 2.0)
    assert np.abs(velocity[:, TORSO, 0]).max() < 1.01 * sway


@pytest.mark.parametrize("speed", [0.3, 1.4, 2.4])
def test_the_gait_is_periodic_and_its_sides_are_half_a_cycle_apart(speed: float) -> None:
    period = cycle_s(speed, STATURE_M)
    for time_s in (0.0, 0.17, 0.4):
        now, later, half = (walker(speed, time_s + t) for t in (0.0, period, 0.5 * period))
        np.testing.assert_allclose(later.position, now.position, atol=1e-9)
        np.testing.assert_allclose(later.velocity, now.velocity, atol=1e-7)
        for number, part in enumerate(NAMES):
            other = part.replace("right", "l").replace("left", "right").replace("l ", "left ")
            mirrored = half.position[NAMES.index(other)] * [1.0, -1.0, 1.0]
            np.testing.assert_allclose(now.position[number], mirrored, atol=1e-9)


def test_a_cycle_has_the_sources_duration() -> None:
    # 1.4 m/s at 1.75 m: RV = 1.4 / 0.859 = 1.629, T_c = 1.346 / 1.276 = 1.054 s; two steps of 0.74 m.
    assert leg_m(STATURE_M) == pytest.approx(0.859, abs=1e-3)
    assert cycle_s(1.4, STATURE_M) == pytest.approx(1.0545, abs=1e-3)


def test_control_points_are_the_sources_in_each_range_and_meet_between_them() -> None:
    """Tables for RV = 0.4, 1.0 and 3.0; and no jump at 0.5 and 1.3."""
    slow, middle, fast = (control_points(rv) for rv in (0.4, 1.0, 3.0))
    assert [angle for _, angle in slow["hip"]] == pytest.approx([20.0, -12.0, 20.0])
    assert [angle for _, angle in middle["hip"]] == pytest.approx([25.0, -15.0, 25.0])
    assert fast["hip"] == (pytest.approx((0.1, 30.0)), pytest.approx((0.5, -15.0)), pytest.approx((0.9, 31.0)))
    assert [angle for _, angle in slow["knee"]] == pytest.approx([3.0, 3.0, 56.0, 3.0])
    assert [angle for _, angle in middle["knee"]] == pytest.approx([3.0, 3.0, 70.0, 3.0])
    assert [angle for _, angle in fast["knee"]] == pytest.approx([25.0, 3.0, 65.0, 6.0])
    assert [angle for _, angle in slow["ankle"]] == pytest.approx([-3.0, -15.0, 5.8, -16.6, -3.0])
    assert [angle for _, angle in middle["ankle"]] == pytest.approx([-3.0, -18.0, 8.0, -20.0, -3.0])
    assert [angle for _, angle in fast["ankle"]] == pytest.approx([2.0, -14.0, 5.0, -28.0, 2.0])
    assert [angle for _, angle in slow["elbow"]] == pytest.approx([5.4, 16.6, 7.0])
    assert [angle for _, angle in middle["elbow"]] == pytest.approx([11.0, 35.0, 13.625])
    assert [angle for _, angle in fast["elbow"]] == pytest.approx([8.0, 70.0, 11.0])
    for border in (0.5, 1.3):
        below, above = (control_points(border + side) for side in (-1e-9, 1e-9))
        for name, points in below.items():
            np.testing.assert_allclose(points, above[name], atol=1e-6)


def test_the_legs_do_what_legs_do() -> None:
    """At the right heel's strike it is ahead, near the ground and slow; in mid-swing the foot is twice as fast."""
    rv = 1.4 / leg_m(STATURE_M)
    place = joints(0.0, rv, STATURE_M)
    assert place["right ankle"].real[0] > 0.25
    assert place["left ankle"].real[0] < -0.1
    assert abs(place["right ankle"].real[2] - 0.039 * STATURE_M) < 0.1
    assert place["left hand"].real[0] > place["right hand"].real[0]  # the arms swing against the legs
    times = np.linspace(0.0, cycle_s(1.4, STATURE_M), 400, endpoint=False)
    foot = np.array([walker(1.4, t).velocity[NAMES.index("right foot"), 0] for t in times]) + 1.4
    assert 2.5 < foot.max() / 1.4 < 4.0
    assert foot.min() / 1.4 > -0.6
    assert np.mean(np.abs(foot) < 0.5) > 0.3  # on the ground
    heights = np.array([joints(t, rv, STATURE_M)["right toe"].real[2] for t in np.linspace(0.0, 1.0, 200)])
    assert -0.12 < heights.min() < 0.1
    crown = joints(0.3, rv, STATURE_M)["crown"].real[2]
    assert crown == pytest.approx(STATURE_M, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "foot", "torso"), [(1.4, 51.0, 5.0), (2.5, 85.5, 13.0)])
def test_accelerations_are_those_that_the_manual_states(speed: float, foot: float, torso: float) -> None:
    """What a constant velocity within a frame of 10 ms leaves out."""
    times = np.linspace(0.0, cycle_s(speed, STATURE_M), 2000, endpoint=False)
    velocity = np.array([walker(speed, t).velocity for t in times])
    acceleration = np.linalg.norm(np.gradient(velocity, times, axis=0), axis=2)
    feet = acceleration[:, [NAMES.index("right foot"), NAMES.index("left foot")]]
    assert 0.9 * foot < feet.max() < foot
    assert acceleration[:, TORSO].max() < torso
    ahead = np.array([walker(speed, t + FRAME_S).position - walker(speed, t).position for t in times])
    error = np.linalg.norm(ahead - velocity * FRAME_S, axis=2)
    assert error.max() < 0.5 * foot * FRAME_S**2


def test_all_parts_together_have_the_pedestrians_level() -> None:
    for radar in (RADAR, np.array([-4.0, 0.0, 1.0]), np.array([0.0, 9.0, 30.0])):
        parts = walker(1.4, 0.2, radar=radar)
        assert parts.rcs_m2.sum() == pytest.approx(0.73)
        assert (parts.rcs_m2 > 0.0).all()
    assert np.argmax(walker(1.4, 0.2).rcs_m2) == TORSO  # from a level view


def test_an_ellipsoid_is_a_sphere_where_it_is_round() -> None:
    cosine = np.linspace(-1.0, 1.0, 9)
    np.testing.assert_allclose(ellipsoid_rcs_m2(np.full(9, 0.1), np.full(9, 0.1), cosine), np.pi * 0.01, rtol=1e-12)
    # Broadside pi c^2, end on pi a^4 / c^2 (Knott, Shaeffer and Tuley, section 6.2).
    one = np.ones(1)
    assert ellipsoid_rcs_m2(0.06 * one, 0.2 * one, 0.0 * one)[0] == pytest.approx(np.pi * 0.04)
    assert ellipsoid_rcs_m2(0.06 * one, 0.2 * one, one)[0] == pytest.approx(np.pi * 0.06**4 / 0.04)


def test_a_walker_who_stands_or_walks_backwards() -> None:
    still = walker(0.0, 3.0)
    assert not still.velocity.any()
    forward, backward = walker(1.1, 0.2), walker(-1.1, -0.2)
    np.testing.assert_allclose(forward.position, backward.position, atol=1e-12)
    np.testing.assert_allclose(forward.velocity, -backward.velocity, atol=1e-9)


def test_options_of_the_pedestrian() -> None:
    assert repr(Pedestrian(stature_m=1.8)) == "Pedestrian(stature_m=1.8)"
    assert len(Pedestrian().parts(RADAR, Motion(1.4)).rcs_m2) == 0
    assert len(Pedestrian(1.8).echoes(RADAR, 4e-3)[1]) == 0
    seeds = [Pedestrian(1.8).parts(RADAR, Motion(1.4, 0.0, seed)).position for seed in (1, 1, 2)]
    assert seeds[0].tobytes() == seeds[1].tobytes()
    assert not np.allclose(seeds[0], seeds[2])
    stated = [Pedestrian(1.8, 0.3).parts(RADAR, Motion(1.4, 0.0, seed)).position for seed in (1, 2)]
    assert stated[0].tobytes() == stated[1].tobytes()
    assert Pedestrian(1.75).unfit(2.5) == ""
    assert "expected at most 2.58 m/s" in Pedestrian(1.75).unfit(-2.6)
    assert Pedestrian().unfit(30.0) == ""
