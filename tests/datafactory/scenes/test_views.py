"""Where drawn poses stand and what they see, against the triangles themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from prepared_scenes import SCENES
from town_scenes import TOWN, box, sheet

from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.poses import FAR_M, SECTOR_DEG, Pose, sample_pose, view_from
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset.folder import SPLITS

SHIPPED = ("street.usda", "street.xml")


def corners_of(scene: Scene) -> NDArray[np.float64]:
    """[T, 3, 3] of every triangle [m]."""
    return np.concatenate([item.vertices[item.triangles] for item in scene.objects])


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
    scene = open_scene(str(SCENES / request.param))
    ground = free_ground(scene)
    splits = [SPLITS[n % 3] for n in range(20)]
    return corners_of(scene), [sample_pose(ground, split, np.random.default_rng(n)) for n, split in enumerate(splits)]


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


@pytest.fixture(scope="module")
def town() -> Ground:
    return free_ground(TOWN)


def test_a_view_along_the_street_is_worth_more_than_one_at_the_wall(town: Ground) -> None:
    along = view_from(town, -80.0, 0.0, 0.0, "train")
    across = view_from(town, -82.0, 8.0, math.pi / 2, "train")
    assert along.farthest_m > 50.0
    assert across.ahead_m == pytest.approx(4.0, abs=1.0)
    assert along.worth > across.worth


def test_what_lies_on_another_side_is_foreign(town: Ground) -> None:
    """At the end of the street: back along it is what the others see, across it what is its own."""
    x = float(town.origin[0] + (town.cells("test")[:, 0].mean() + 0.5) * town.cell_m)
    assert view_from(town, x, 0.0, math.pi, "test").foreign > 0.5
    assert view_from(town, x, 0.0, 0.0, "test").foreign == 0.0
    assert view_from(town, x, 0.0, 0.0, "train").foreign == 1.0


def test_drawn_poses_see_little_of_another_split(town: Ground) -> None:
    """In a street of one axis; in cities, none: docs/trajectories.md."""
    for split in SPLITS:
        shares = []
        for seed in range(30):
            pose = sample_pose(town, split, np.random.default_rng(seed))
            shares.append(view_from(town, *pose.position[:2], math.radians(pose.yaw_deg), split).foreign)
        assert np.mean(shares) < 0.05, split


def test_a_pose_is_tilted_as_the_ground_is() -> None:
    hill = sheet("hill", (-60.0, 60.0), (-30.0, 30.0), lambda x, y: 0.1 * x)
    scene = Scene("hill", (hill, box("hut", (-3.0, 20.0, -9.0), (3.0, 28.0, 20.0))))
    for seed in range(10):
        pose = sample_pose(free_ground(scene), "train", np.random.default_rng(seed))
        up = pose.rotation()[:, 2]
        np.testing.assert_allclose(up, np.array([-0.1, 0.0, 1.0]) / math.hypot(0.1, 1.0), atol=1e-9)
        vx, _, vz = pose.velocity
        assert vz == pytest.approx(0.1 * vx)
