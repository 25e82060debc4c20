"""Poses and free ground: rotations, files, separated regions, and clearance measured against the triangles."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from town_scenes import BUILDINGS, CAR, POLE, TOWN, box, flat, sheet

from datafactory.scenes.buried import buried
from datafactory.scenes.ground import CELL_M, CLEARANCE_M, SPLITS, free_ground, height_map
from datafactory.scenes.poses import DRAWN_SPEEDS, SENSOR_HEIGHT_M, Pose, read_poses, sample_pose
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.targets.models import Car
from shared.physics.errors import InputError

# --- rotations ------------------------------------------------------------------------------------------------------


def test_axes_of_each_angle():
    """Yaw turns the boresight left; positive pitch points it down; positive roll lifts the left side."""
    origin = (0.0, 0.0, 0.0)
    np.testing.assert_allclose(Pose(origin, yaw_deg=90).rotation() @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(Pose(origin, pitch_deg=90).rotation() @ [1, 0, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(Pose(origin, roll_deg=90).rotation() @ [0, 1, 0], [0, 0, 1], atol=1e-12)


def test_yaw_goes_first_then_pitch_about_the_new_axis():
    """Yawed left and pitched down, the boresight is still in the vertical plane through the left."""
    boresight = Pose((0.0, 0.0, 0.0), yaw_deg=90, pitch_deg=30).rotation() @ [1, 0, 0]
    np.testing.assert_allclose(boresight, [0.0, math.cos(math.pi / 6), -0.5], atol=1e-12)


angles = st.floats(-720, 720)


@given(angles, st.floats(-89, 89), angles)
def test_quaternion_and_matrix_are_the_same_rotation(yaw, pitch, roll):
    pose = Pose((0.0, 0.0, 0.0), yaw, pitch, roll)
    w, x, y, z = pose.quaternion()
    from_quaternion = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    rotation = pose.rotation()
    np.testing.assert_allclose(rotation, from_quaternion, atol=1e-9)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert w >= 0.0


# --- files ----------------------------------------------------------------------------------------------------------


def test_reads_what_is_given_and_fills_the_rest_with_zero(tmp_path):
    full = {
        "position": [1, 2.5, 3],
        "yaw_deg": 10,
        "pitch_deg": -2,
        "roll_deg": 1,
        "velocity": [4, 5, 0],
        "time": 0.25,
    }
    (tmp_path / "poses.json").write_text(json.dumps([full, {"position": [0, 0, 1]}]), encoding="utf-8")
    poses = read_poses(tmp_path / "poses.json")
    assert poses == (Pose((1, 2.5, 3), 10, -2, 1, (4, 5, 0), 0.25), Pose((0, 0, 1)))


# --- free ground ----------------------------------------------------------------------------------------------------


def gap_to_box(x, y, item):
    """Horizontal distance [m] from points to an upright box, 0 inside it."""
    lower, upper = item.vertices.min(axis=0), item.vertices.max(axis=0)
    away = [np.maximum(np.maximum(lower[axis] - at, at - upper[axis]), 0.0) for axis, at in enumerate((x, y))]
    return np.hypot(*away)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"position": (0.0, 0.0, np.nan)}, r"Pose: position = \(0\.0, 0\.0, nan\); expected three finite numbers"),
        ({"position": (0.0, 0.0)}, "Pose: position = .*; expected three finite numbers"),
        ({"position": (0.0, 0.0, 1.0), "yaw_deg": np.inf}, "Pose: yaw_deg = inf; expected a finite number"),
        ({"position": "abc"}, "Pose: position = 'abc'; expected three finite numbers"),
        ({"position": 1.0}, r"Pose: position = 1\.0; expected three finite numbers"),
        ({"position": (0.0, 0.0, 1.0), "yaw_deg": "x"}, "Pose: yaw_deg = 'x'; expected a finite number"),
        ({"position": (0.0, 0.0, 1.0), "time_s": None}, "Pose: time_s = None; expected a finite number"),
    ],
)
def test_a_pose_is_finite(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Pose(**given)


def test_a_pose_holds_plain_numbers() -> None:
    pose = Pose(np.array([1, 2, 3]), velocity=np.zeros(3, dtype=np.float32))  # type: ignore[arg-type]
    assert pose == Pose((1.0, 2.0, 3.0))
    assert json.dumps(pose.position) == "[1.0, 2.0, 3.0]"


def test_places_under_the_ground_and_inside_what_stands_are_found():
    """Not those under a bridge, under a sheet, under a car or beside the scene; what moves is not looked at."""
    parked, bridge = (
        box("parked", (3.0, -4.0, 0.3), (7.0, -2.0, 1.5)),
        box("bridge", (20.0, -5.0, 4.0), (24.0, 5.0, 5.0)),
    )
    scene = Scene("town", (*TOWN.objects, parked, bridge, sheet("canopy", (40.0, 44.0), (-2.0, 2.0), lambda x, y: 3.0)))
    hidden = [(0.0, 0.0, -0.5), (5.0, -3.0, 0.5), (22.0, 0.0, 4.5), (22.0, 0.0, -0.5), (-80.0, 20.0, -0.5)]
    seeing = [(0.0, 0.0, 0.5), (5.0, -3.0, 0.1), (22.0, 0.0, 0.5), (42.0, 0.0, 0.5), (5.0, 3.0, 0.5), (5.0, -3.0, 1.6),
              (0.0, 0.0, 20.0), (500.0, 0.0, -1.0)]  # fmt: skip
    assert buried(scene, np.array([*hidden, *seeing])).tolist() == [True] * len(hidden) + [False] * len(seeing)
    assert buried(scene, np.zeros((0, 3))).tolist() == []


def test_places_inside_what_stands_on_the_ground_or_in_it_are_found():
    """As every house does: its floor is no lower than the ground, or hidden by it."""
    ground = sheet("ground", (-20.0, 20.0), (-20.0, 20.0), lambda x, y: 0.0)
    houses = (box("on it", (5.0, -2.0, 0.0), (9.0, 2.0, 6.0)), box("in it", (-9.0, -2.0, -0.5), (-5.0, 2.0, 6.0)))
    places = np.array([(x, 0.0, z) for x in (7.0, -7.0, 0.0) for z in (0.5, 6.5)])
    for objects in ((ground, *houses), (*houses, ground)):
        assert buried(Scene("town", objects), places).tolist() == [True, False, True, False, False, False]


def free_centres(ground):
    i, j = np.nonzero(ground.free)
    return ground.origin[0] + (i + 0.5) * ground.cell_m, ground.origin[1] + (j + 0.5) * ground.cell_m


def test_height_map_sees_flat_roofs_walls_and_thin_poles():
    seen = height_map(TOWN, 0.5)
    i, j = int((30.05 + 110) / 0.5), int((-3.0 + 50) / 0.5)
    assert seen.highest[i, j] == 4.0  # thinner than a cell, and still the cell's highest point
    assert seen.surface[int((-80 + 110) / 0.5), int((20 + 50) / 0.5)] == 12.0
    assert seen.surface[int((-60 + 110) / 0.5), int((0 + 50) / 0.5)] == 0.0


def test_height_map_of_a_slope_is_the_plane():
    slope = Scene("slope", (sheet("hill", (0.0, 30.0), (0.0, 20.0), lambda x, y: 0.3 * x - 0.1 * y),))
    seen = height_map(slope, 1.0)
    x, y = np.meshgrid(np.arange(30) + 0.5, np.arange(20) + 0.5, indexing="ij")
    np.testing.assert_allclose(seen.surface, 0.3 * x - 0.1 * y, atol=1e-9)
    np.testing.assert_allclose(seen.highest, 0.3 * (x + 0.5) - 0.1 * (y - 0.5), atol=1e-9)


def test_height_map_coarsens_instead_of_growing():
    seen = height_map(Scene("plain", (sheet("floor", (0.0, 5000.0), (0.0, 4000.0), flat),)), 0.5)
    assert seen.surface.size <= 1.01e6
    assert np.isfinite(seen.surface[:-1, :-1]).all()  # the last cells may reach beyond the plane


def test_no_free_cell_is_on_a_roof_or_near_anything(town):
    x, y = free_centres(town)
    for item in (*BUILDINGS, CAR, POLE):
        assert gap_to_box(x, y, item).min() >= CLEARANCE_M, item.name


def test_most_of_the_street_is_free(town):
    """The middle of the street, away from car and pole: a rule that refuses everything fails here."""
    x, y = free_centres(town)
    street = (np.abs(y) < 1.0) & (x > -90) & (x < -10)
    assert np.count_nonzero(street) * town.cell_m**2 > 0.95 * 2.0 * 80.0


def test_roofs_are_not_ground_even_where_they_are_the_larger_part():
    """A flat hall that covers most of a small plate: the street around it is the ground."""
    hall = box("hall", (-40.0, -30.0, 0.0), (40.0, 30.0, 8.0))
    ground = free_ground(Scene("hall", (sheet("floor", (-60.0, 60.0), (-45.0, 45.0), flat), hall)))
    assert np.nanmax(ground.height_m[ground.free]) == 0.0


def test_gentle_slopes_are_free_and_steep_ones_are_not():
    def terrain(slope):
        return Scene(
            "terrain",
            (
                sheet("plain", (-80.0, 0.0), (-30.0, 30.0), flat),
                sheet("hill", (0.0, 80.0), (-30.0, 30.0), lambda x, y: slope * x),
                box("hut", (-5.0, -5.0, 0.0), (5.0, 5.0, 30.0)),
            ),
        )

    def uphill(slope):
        ground = free_ground(terrain(slope))
        return np.count_nonzero(free_centres(ground)[0] > 8.0)

    assert uphill(0.1) > 500
    assert uphill(0.5) == 0


def test_kerbs_are_driven_over_and_ledges_are_not():
    def free_near_edge(step):
        scene = Scene(
            "step",
            (
                sheet("low", (-60.0, 0.0), (-20.0, 20.0), flat),
                sheet("high", (0.0, 60.0), (-20.0, 20.0), lambda x, y: step),
                box("hut", (-3.0, -20.0, 0.0), (3.0, -14.0, 5.0)),
            ),
        )
        x, y = free_centres(free_ground(scene))
        return np.count_nonzero((np.abs(x) < 1.0) & (y > -5) & (y < 15))

    assert free_near_edge(0.1) > 0
    assert free_near_edge(0.6) == 0


def test_regions_are_apart_by_the_gap_and_in_proportion(town):
    assert town.gap_m >= max(5.0, 0.05 * 200)
    along = [town.cells(split)[:, 0] for split in SPLITS]
    for near, far in ((0, 1), (1, 2)):
        assert (along[far].min() - along[near].max() - 1) * town.cell_m >= town.gap_m - 1e-9
    areas = np.array([town.area_m2(split) for split in SPLITS])
    np.testing.assert_allclose(areas / areas.sum(), [0.75, 0.125, 0.125], atol=0.01)
    assert np.all(town.free[town.region >= 0])


def test_poses_keep_to_their_region_and_to_free_ground(town):
    low = {split: town.origin[0] + town.cells(split)[:, 0].min() * town.cell_m for split in SPLITS}
    high = {split: town.origin[0] + (town.cells(split)[:, 0].max() + 1) * town.cell_m for split in SPLITS}
    for split in SPLITS:
        for seed in range(25):
            pose = sample_pose(town, split, np.random.default_rng(seed))
            x, y, z = pose.position
            assert low[split] <= x <= high[split]
            assert z == pytest.approx(SENSOR_HEIGHT_M)
            assert min(gap_to_box(x, y, item) for item in (*BUILDINGS, CAR, POLE)) >= CLEARANCE_M
            assert math.hypot(*pose.velocity) <= 6.0
            assert pose.velocity[2] == pose.pitch_deg == pose.roll_deg == 0.0


def test_speeds_and_directions_fill_their_range(town):
    velocities = np.array([sample_pose(town, "train", np.random.default_rng(n)).velocity for n in range(150)])
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    assert speed.mean() == pytest.approx(3.0, abs=0.6)  # sigma of the mean: 6 / sqrt(12 x 150) = 0.14
    assert speed.max() > 5.0
    assert np.abs(velocities[:, :2].mean(axis=0)).max() < 1.0


def test_other_speeds_change_the_speed_alone(town):
    for seed in range(5):
        usual, fast = (
            sample_pose(town, "train", np.random.default_rng(seed), speeds) for speeds in (DRAWN_SPEEDS, (10.0, 22.0))
        )
        assert replace(fast, velocity=usual.velocity) == usual
        speed, other = (np.hypot(*pose.velocity[:2]) for pose in (usual, fast))
        assert other == pytest.approx(10.0 + 2.0 * speed)
        np.testing.assert_allclose(np.array(fast.velocity) / other, np.array(usual.velocity) / speed, atol=1e-12)


def test_free_path_measures_the_distance_to_a_wall():
    wall = box("wall", (20.0, -20.0, 0.0), (21.0, 20.0, 3.0))
    ground = free_ground(Scene("wall", (sheet("floor", (-30.0, 40.0), (-30.0, 30.0), flat), wall)))
    ahead, behind, short = (
        ground.free_path(2.0, 0.0, np.array([heading]), reach)[0]
        for heading, reach in ((0.0, 90.0), (math.pi, 90.0), (0.0, 10.0))
    )
    assert ahead == pytest.approx(18.0, abs=1.0)
    assert behind == np.inf
    assert short == np.inf


def test_roads_are_preferred(road):
    """On the road with probability 0.8 + 0.2 x its share of the area (0.09): 0.82; without preference 0.09."""
    on_road = [abs(sample_pose(road, "train", np.random.default_rng(n)).position[1]) <= 4.0 for n in range(100)]
    assert 0.7 < np.mean(on_road) < 0.95


def test_moving_the_scene_moves_the_ground(town):
    """A kilometre away in x and y, 300 m up: the same cells."""
    shift = np.array([1000.0, -2000.0, 300.0])
    moved = tuple(SceneObject(item.name, item.vertices + shift, item.triangles, item.material) for item in TOWN.objects)
    ground = free_ground(Scene("moved", moved))
    assert np.mean(ground.free != town.free) < 1e-3
    pose = sample_pose(ground, "test", np.random.default_rng(0))
    assert pose.position[2] == pytest.approx(300.0 + SENSOR_HEIGHT_M)


def test_no_free_ground_says_what_to_do():
    with pytest.raises(InputError, match=r"no free ground: .*--poses"):
        free_ground(Scene("tower", (box("tower", (0.0, 0.0, 0.0), (3.0, 3.0, 30.0)),)))
    with pytest.raises(InputError, match="the scene has no objects"):
        free_ground(Scene("empty", ()))


def test_ground_too_small_for_three_regions_says_what_to_do():
    yard = Scene("yard", (sheet("floor", (0.0, 12.0), (0.0, 8.0), flat),))
    ground = free_ground(yard)
    with pytest.raises(InputError, match=r"yard: no free ground is left for test: .*--poses"):
        sample_pose(ground, "test", np.random.default_rng(0))
    assert sample_pose(ground, "train", np.random.default_rng(0)).position[2] == SENSOR_HEIGHT_M


def test_no_pose_stands_within_a_target_models_footprint_or_near_a_point_target():
    ground = sheet("ground", (-15.0, 15.0), (-15.0, 15.0), flat, "asphalt")
    car = PointTarget("car", (1.0, 2.0, 0.0), 11.0, model=Car())
    post = PointTarget("post", (-7.0, -7.0, 0.5), 0.0)
    free = free_ground(Scene("parking", (ground,), (car, post))).free
    x, y = (-15.0 + CELL_M * (index + 0.5) for index in np.nonzero(free))
    assert np.hypot(x - 1.0, y - 2.0).min() > Car.footprint_m
    assert np.hypot(x + 7.0, y + 7.0).min() >= CLEARANCE_M
