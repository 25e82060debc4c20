"""Streets and lanes, to the right of the middle, smooth; where drawn poses stand, and what they see."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from prepared_scenes import SCENES
from town_scenes import box, flat, sheet

from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.lanes import LANE_OFFSET_M, STEP_M, Lane, draw_lane
from datafactory.scenes.motion import Real
from datafactory.scenes.poses import FAR_M, SECTOR_DEG, Pose, sample_pose, view_from
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.scenes.streets import KERB_M, WIDEST_STREET_M, cut_into_regions
from shared.dataset.folder import SPLITS


@pytest.fixture(scope="module")
def crossing() -> Ground:
    """Two streets 20 m wide that cross between four blocks."""
    blocks = [
        box(f"block{x}{y}", (x, y, 0.0), (x + 60.0, y + 60.0, 9.0)) for x in (-70.0, 10.0) for y in (-70.0, 10.0)
    ]  # fmt: skip
    return free_ground(Scene("crossing", (sheet("floor", (-75.0, 75.0), (-75.0, 75.0), flat), *blocks)))


def drawn(ground: Ground, length_m: float, seed: int) -> Lane:
    lane = draw_lane(ground, length_m, np.random.default_rng(seed), ground.street)
    assert lane is not None
    return lane


def heading_rad(lane: Lane) -> Real:
    """[n] direction of travel, counted from x to y, without jumps [rad]."""
    along = np.gradient(lane.points, lane.distance_m, axis=0)
    return np.unwrap(np.arctan2(along[:, 1], along[:, 0]))


def test_a_lane_keeps_to_the_right_of_the_street_s_middle(street: Ground) -> None:
    """The street lies along y = 0. Whoever drives to positive x keeps at negative y, and the other way round."""
    both = set()
    for seed in range(12):
        lane = drawn(street, 40.0, seed)
        straight = np.abs(np.sin(heading_rad(lane))) < 0.02
        to_x = np.sign(np.cos(heading_rad(lane)[straight]))
        np.testing.assert_allclose(lane.points[straight, 1], -to_x * LANE_OFFSET_M, atol=0.6)
        both |= set(to_x)
    assert both == {-1.0, 1.0}


def test_every_point_is_on_an_allowed_cell(crossing: Ground) -> None:
    for seed in range(12):
        i, j = crossing.cell_of(*drawn(crossing, 60.0, seed).points.T)
        assert crossing.street[i, j].all()


def test_lanes_turn_at_crossings_as_a_car_can(crossing: Ground) -> None:
    """A radius of at least 5 m, and some lane of twelve goes round the corner."""
    turned = []
    for seed in range(12):
        lane = drawn(crossing, 60.0, seed)
        assert np.abs(lane.curvature).max() < 1.0 / 5.0
        turned.append(np.ptp(heading_rad(lane)))
    assert max(turned) > 1.3


def test_points_stand_evenly_and_the_length_is_what_was_wanted(crossing: Ground) -> None:
    for seed in range(6):
        lane = drawn(crossing, 50.0, seed)
        steps = np.hypot(*np.diff(lane.points, axis=0).T)
        assert np.all((steps > 0.8 * STEP_M) & (steps <= STEP_M + 1e-9))
        assert 49.0 < lane.length_m < 52.0


def test_a_circle_has_the_curvature_of_a_circle() -> None:
    angle = np.linspace(0.0, np.pi, 200)
    lane = Lane(20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert lane.length_m == pytest.approx(20.0 * np.pi, rel=1e-3)
    np.testing.assert_allclose(lane.curvature[3:-3], 1.0 / 20.0, rtol=1e-3)
    np.testing.assert_allclose(np.diff(heading_rad(lane)[2:-2]), np.pi / 199, rtol=1e-3)


def test_cells_without_room_have_no_lane(crossing: Ground) -> None:
    assert draw_lane(crossing, 50.0, np.random.default_rng(0), np.zeros_like(crossing.free)) is None
    spots = np.zeros_like(crossing.free)
    spots[150:152, 150:152] = True
    assert draw_lane(crossing, 50.0, np.random.default_rng(0), spots) is None


def hollow(door: bool) -> tuple[SceneObject, ...]:
    """A hall of 30 m with walls, and a roof that has a hole of 16 m: its floor is the topmost surface there.

    :param door: a gap of 8 m in one wall and in the roof above it
    """
    walls = [
        box("south", (-15.0, 20.0, 0.0), (15.0, 20.3, 6.0)),
        box("north", (-15.0, 49.7, 0.0), (15.0, 50.0, 6.0)),
        box("east", (14.7, 20.0, 0.0), (15.0, 50.0, 6.0)),
    ]
    for n, (low, high) in enumerate(((20.0, 31.0), (39.0, 50.0)) if door else ((20.0, 50.0),)):
        walls.append(box(f"west-{n}", (-15.0, low, 0.0), (-14.7, high, 6.0)))
    roof = [
        box("roof-south", (-15.0, 20.0, 6.0), (15.0, 27.0, 6.2)),
        box("roof-north", (-15.0, 43.0, 6.0), (15.0, 50.0, 6.2)),
        box("roof-east", (8.0, 27.0, 6.0), (15.0, 43.0, 6.2)),
    ]
    for n, (low, high) in enumerate(((27.0, 31.0), (39.0, 43.0)) if door else ((27.0, 43.0),)):
        roof.append(box(f"roof-west-{n}", (-15.0, low, 6.0), (-8.0, high, 6.2)))
    return (*walls, *roof)


def free_within(ground: Ground, low: tuple[float, float], high: tuple[float, float]) -> int:
    i, j = np.nonzero(ground.free)
    x, y = ground.origin[0] + (i + 0.5) * ground.cell_m, ground.origin[1] + (j + 0.5) * ground.cell_m
    return int(np.count_nonzero((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])))


PLAIN = sheet("floor", (-80.0, 80.0), (-40.0, 70.0), flat)


def test_no_pose_stands_in_a_hollow_building_under_the_hole_of_its_roof() -> None:
    ground = free_ground(Scene("hall", (PLAIN, *hollow(door=False))))
    assert free_within(ground, (-15.0, 20.0), (15.0, 50.0)) == 0
    assert free_within(ground, (-60.0, -30.0), (60.0, 10.0)) > 1000
    for seed in range(40):
        x, y, _ = sample_pose(ground, "train", np.random.default_rng(seed)).position
        assert not (-15.0 < x < 15.0 and 20.0 < y < 50.0)


def test_what_a_way_leads_to_is_kept() -> None:
    """The same hall with a gap that a car can pass: its yard is a yard."""
    ground = free_ground(Scene("hall", (PLAIN, *hollow(door=True))))
    assert free_within(ground, (-15.0, 20.0), (15.0, 50.0)) > 200


def test_a_walled_yard_without_a_roof_is_left_out_too() -> None:
    walls = tuple(item for item in hollow(door=False) if not item.name.startswith("roof"))
    assert free_within(free_ground(Scene("yard", (PLAIN, *walls))), (-15.0, 20.0), (15.0, 50.0)) == 0


def test_roads_that_a_ledge_or_a_rail_parts_from_the_largest_ground_are_kept() -> None:
    """A road 0.42 m above open land that is larger, a rail along its middle; a small yard of asphalt is none."""
    land = sheet("land", (-100.0, 100.0), (-60.0, 60.0), lambda x, y: -0.42)
    road = sheet("/World/Road_0/mesh", (-100.0, 100.0), (-9.0, 9.0), flat, "asphalt")
    rail = box("rail", (-100.0, -0.2, 0.0), (100.0, 0.2, 0.8), "metal")
    yard = sheet("yard", (-4.0, 4.0), (31.0, 39.0), lambda x, y: -0.41, "asphalt")
    walls = [item for item in hollow(door=False) if not item.name.startswith("roof")]
    walls = [replace(item, vertices=item.vertices - [0.0, 0.0, 0.5]) for item in walls]
    ground = free_ground(Scene("causeway", (land, road, rail, yard, *walls)))
    for low, high in ((-9.0, 0.0), (0.0, 9.0)):
        assert free_within(ground, (-80.0, low), (80.0, high)) > 1000
    assert free_within(ground, (-15.0, 20.0), (15.0, 50.0)) == 0
    for seed in range(20):
        assert abs(sample_pose(ground, "train", np.random.default_rng(seed)).position[1]) < 9.0


def test_streets_lie_between_facades_and_the_open_land_behind_them_does_not(street: Ground) -> None:
    assert np.all(street.free[street.street])
    i, j = np.nonzero(street.street)
    y = street.origin[1] + (j + 0.5) * street.cell_m
    assert np.abs(y).max() < 30.0  # the houses end at 28 m; a cell beside a gap between two is still between them
    here = (np.abs(y) < 1.0) & (np.abs(street.origin[0] + (i + 0.5) * street.cell_m) < 80.0)
    assert np.count_nonzero(here) * street.cell_m**2 > 0.95 * 2.0 * 160.0


def test_facades_too_far_apart_make_no_street() -> None:
    def street_area(width: float) -> float:
        houses = [
            box(f"house{side}", (-60.0, min(side * width / 2, side * (width / 2 + 9)), 0.0),
                (60.0, max(side * width / 2, side * (width / 2 + 9)), 9.0))
            for side in (-1.0, 1.0)
        ]  # fmt: skip
        ground = free_ground(Scene("two", (sheet("floor", (-90.0, 90.0), (-60.0, 60.0), flat), *houses)))
        return float(np.count_nonzero(ground.street)) / np.count_nonzero(ground.free)

    assert street_area(WIDEST_STREET_M - 5.0) < 0.7
    assert street_area(WIDEST_STREET_M + 5.0) == 1.0  # no streets: all free ground is used


def test_named_roads_and_their_kerbs_are_the_streets(road: Ground) -> None:
    _, j = np.nonzero(road.street)
    assert np.abs(road.origin[1] + (j + 0.5) * road.cell_m).max() <= 4.0 + KERB_M


def test_every_cell_of_a_region_lies_on_its_own_side_half_a_gap_from_the_next() -> None:
    cells = np.ones((400, 40), dtype=bool)
    region, side, gap_m = cut_into_regions(cells, 0.5)
    lines = [np.flatnonzero((region == number).any(axis=1)) for number in range(len(SPLITS))]
    for number, own in enumerate(lines):
        assert np.all(side[own] == number)
        for other in range(len(SPLITS)):
            if other != number:
                theirs = np.flatnonzero((side == other).any(axis=1))
                nearest = np.abs(own[:, None] - theirs[None, :]).min() - 1
                assert nearest * 0.5 >= gap_m / 2 - 0.5
    assert gap_m == pytest.approx(12.0)


SHIPPED = ("street.usda", "street.xml")


def free_path(corners: NDArray[np.float64], start: NDArray[np.float64], way: NDArray[np.float64]) -> float:
    """Distance to the first triangle along a ray, by the test of Moeller and Trumbore on each; inf for none."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(way, other)
    determinant = np.einsum("ti,ti->t", one, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        from_corner = start - corners[:, 0]
        u = np.einsum("ti,ti->t", from_corner, normal) / determinant
        across = np.cross(from_corner, one)
        v = across @ way / determinant
        distance = np.einsum("ti,ti->t", other, across) / determinant
        met = (np.abs(determinant) > 1e-12) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
    return float(distance[met].min(initial=np.inf))


@pytest.fixture(scope="module", params=SHIPPED)
def shipped(request: pytest.FixtureRequest) -> tuple[NDArray[np.float64], list[Pose]]:
    """[T, 3, 3] corners of every triangle [m], and poses."""
    scene = open_scene(str(SCENES / request.param))
    corners = np.concatenate([item.vertices[item.triangles] for item in scene.objects])
    ground = free_ground(scene)
    splits = [SPLITS[n % 3] for n in range(20)]
    return corners, [sample_pose(ground, split, np.random.default_rng(n)) for n, split in enumerate(splits)]


def test_twenty_poses_stand_clear_of_every_triangle_but_the_ground(
    shipped: tuple[NDArray[np.float64], list[Pose]],
) -> None:
    """Every triangle: nothing but ground within 1 m, nothing above the sensor, and the ground 0.5 m below it."""
    corners, poses = shipped
    for pose in poses:
        here = np.asarray(pose.position)
        nearest = trimesh.triangles.closest_point(corners, np.repeat([here], len(corners), axis=0))
        distance = np.linalg.norm(nearest - here, axis=1)
        standing = nearest[:, 2] > here[2] - 0.3
        assert distance[standing].min() > 1.0
        assert free_path(corners, here, np.array([0.0, 0.0, -1.0])) == pytest.approx(0.5, abs=0.1)
        assert free_path(corners, here, np.array([0.0, 0.0, 1.0])) == np.inf


def test_a_ray_of_the_field_of_view_reaches_fifteen_metres(shipped: tuple[NDArray[np.float64], list[Pose]]) -> None:
    """Every triangle: the view is not blocked, and not all of it is a wall."""
    corners, poses = shipped
    for pose in poses:
        angle = math.radians(pose.yaw_deg) + np.radians(np.linspace(-SECTOR_DEG, SECTOR_DEG, 25))
        ways = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        free = np.array([free_path(corners, np.asarray(pose.position), way) for way in ways])
        assert free.max() >= FAR_M - 0.5
        assert free.min() > 1.0


def test_a_view_along_the_street_is_worth_more_than_one_at_the_wall(town: Ground) -> None:
    along = view_from(town, -80.0, 0.0, 0.0, "train")
    across = view_from(town, -82.0, 8.0, math.pi / 2, "train")
    assert along.along
    assert across.ahead_m == pytest.approx(4.0, abs=1.0)
    assert along > across


def test_what_lies_on_another_side_is_foreign(town: Ground) -> None:
    """At the end of the street: back along it is what the others see, across it what is its own."""
    x = float(town.origin[0] + (town.cells("test")[:, 0].mean() + 0.5) * town.cell_m)
    assert view_from(town, x, 0.0, math.pi, "test").own < -0.5
    assert view_from(town, x, 0.0, 0.0, "test").own == 0.0
    assert view_from(town, x, 0.0, 0.0, "train").own == -1.0


def test_drawn_poses_see_little_of_another_split(town: Ground) -> None:
    """In a street of one axis; in cities, none: docs/trajectories.md."""
    for split in SPLITS:
        shares = []
        for seed in range(30):
            pose = sample_pose(town, split, np.random.default_rng(seed))
            shares.append(view_from(town, *pose.position[:2], math.radians(pose.yaw_deg), split).own)
        assert np.mean(shares) > -0.05, split


def test_a_pose_is_tilted_as_the_ground_is() -> None:
    hill = sheet("hill", (-60.0, 60.0), (-30.0, 30.0), lambda x, y: 0.1 * x)
    scene = Scene("hill", (hill, box("hut", (-3.0, 20.0, -9.0), (3.0, 28.0, 20.0))))
    for seed in range(10):
        pose = sample_pose(free_ground(scene), "train", np.random.default_rng(seed))
        up = pose.rotation()[:, 2]
        np.testing.assert_allclose(up, np.array([-0.1, 0.0, 1.0]) / math.hypot(0.1, 1.0), atol=1e-9)
        vx, _, vz = pose.velocity
        assert vz == pytest.approx(0.1 * vx)
