"""Unfolded mirrors, and bodies that turn: what paths say of motion against traces of two moments."""

from typing import Any

import numpy as np
import pytest
from curved_scenes import Mesh, sphere, tube
from numpy.typing import NDArray
from oracles import mirror_path, mirrored
from sionna_scenes import MATERIALS, TURN_DEG_PER_S, mesh, plate, scene_of, turning
from sionna_scenes import traced as trace_of
from town_scenes import box

from datafactory.paths.bodies import bodies_of
from datafactory.paths.edges import edges_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.planes import Rim, planes_of
from datafactory.paths.rows import image_seen_from_tx, tx_image_seen_from_rx
from datafactory.paths.table import CORNER, PathTable
from datafactory.scenes.motion import Track
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject
from shared.physics.vectors import unit

pytestmark = pytest.mark.usefixtures("variant")

Plane = tuple[NDArray[np.float64], NDArray[np.float64]]
ORIGIN = np.zeros(3)


def random_chain(
    generator: np.random.Generator, mirrors: int, end: NDArray[np.float64]
) -> tuple[list[Plane], NDArray[np.float64]]:
    """Planes and vertices of a path from the origin to ``end`` on which every reflection is a real one."""
    while True:
        planes = [(generator.uniform(-15.0, 15.0, 3), unit(generator.normal(size=3))) for _ in range(mirrors)]
        _, vertices = mirror_path(ORIGIN, end, planes)
        chain = np.concatenate([[ORIGIN], vertices, [end]])
        sides = [
            ((chain[k] - plane[0]) @ plane[1], (chain[k + 2] - plane[0]) @ plane[1]) for k, plane in enumerate(planes)
        ]
        if all(before * after > 0.5 for before, after in sides) and np.abs(vertices).max() < 60.0:
            return planes, vertices


def moved(planes: list[Plane], velocities: NDArray[np.float64], time_s: float) -> list[Plane]:
    return [(origin + velocity * time_s, normal) for (origin, normal), velocity in zip(planes, velocities, strict=True)]


@pytest.mark.parametrize("mirrors", [0, 1, 2])
def test_image_of_a_scatterer_behind_moving_mirrors(mirrors):
    generator = np.random.default_rng(3)
    for _ in range(10):
        scatterer = generator.uniform(-8.0, 8.0, 3)
        planes, vertices = random_chain(generator, mirrors, scatterer) if mirrors else ([], np.zeros((0, 3)))
        velocities = generator.uniform(-10.0, 10.0, (mirrors + 1, 3))

        def seen_from_tx(time_s, planes=planes, velocities=velocities, scatterer=scatterer):
            image = scatterer + velocities[-1] * time_s
            for plane in reversed(moved(planes, velocities[:-1], time_s)):
                image = mirrored(image, plane)
            return image

        chain = np.concatenate([vertices, [scatterer]])[None]
        position, velocity = image_seen_from_tx(chain, velocities[None], np.array([mirrors]))
        np.testing.assert_allclose(position[0], seen_from_tx(0.0), atol=1e-8)
        np.testing.assert_allclose(velocity[0], seen_from_tx(1.0) - seen_from_tx(0.0), atol=1e-8)


def test_paths_of_different_numbers_of_mirrors_stand_together():
    # Bounces after the scattering one do not change what the TX sees of it.
    generator = np.random.default_rng(4)
    scatterer, after = np.array([6.0, 1.0, 0.5]), np.array([3.0, -4.0, 1.0])
    planes, vertices = random_chain(generator, 1, scatterer)
    direct = np.stack([scatterer, after, after + 1.0])
    mirrored_first = np.stack([vertices[0], scatterer, after])
    position, velocity = image_seen_from_tx(
        np.stack([direct, mirrored_first]), np.tile([1.0, 2.0, 3.0], (2, 3, 1)), np.array([0, 1])
    )
    np.testing.assert_allclose(position, [scatterer, mirrored(scatterer, planes[0])], atol=1e-9)
    # Mirror and point move alike: so does the image.
    np.testing.assert_allclose(velocity, np.tile([1.0, 2.0, 3.0], (2, 1)), atol=1e-9)


@pytest.mark.parametrize("mirrors", [1, 2, 3])
@pytest.mark.parametrize("moving", [False, True])
def test_delay_law_of_mirrors_holds_for_every_pair_of_elements(mirrors, moving):
    generator = np.random.default_rng(5)
    for _ in range(10):
        planes, vertices = random_chain(generator, mirrors, ORIGIN)
        velocities = generator.uniform(-10.0, 10.0, (mirrors, 3)) * moving
        image, velocity, axes = tx_image_seen_from_rx(vertices[None], velocities[None])
        np.testing.assert_allclose(axes[0] @ axes[0].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes[0]) == pytest.approx((-1.0) ** mirrors)
        for _ in range(5):
            tx, rx = generator.uniform(-0.3, 0.3, (2, 3))
            time_s = generator.uniform(0.0, 0.02)
            exact, _ = mirror_path(tx, rx, moved(planes, velocities, time_s))
            law = np.linalg.norm(rx - (image[0] + velocity[0] * time_s + axes[0] @ tx))
            assert law == pytest.approx(exact, abs=1e-8)


STEP_S = 1e-5
POSE = Pose((0.0, 0.0, 0.0), velocity=(1.0, 0.5, 0.0), time_s=0.2)


PLATE = plate("plate", (8.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 3.0), "metal")
HOUSE = box("house", (20.0, -9.0, -1.0), (25.0, 9.0, 8.0), "metal")
CAR = box("car", (7.0, -2.0, -1.0), (9.0, 2.0, 1.0), "metal")


def traced(merged: MergedScene, pose: Pose, **settings: Any) -> PathTable:
    return trace_of(merged, pose, **{"rays": 4_000, "depth": 1, "paths_a_cell": 0, "solver_share": 1, **settings})


def later(pose: Pose, seconds: float = STEP_S) -> Pose:
    moved = np.array(pose.position) + seconds * np.array(pose.velocity)
    x, y, z = (float(value) for value in moved)
    return Pose((x, y, z), pose.yaw_deg, pose.pitch_deg, pose.roll_deg, pose.velocity, pose.time_s + seconds)


def test_the_image_in_a_turning_mirror_moves_as_two_traces_say() -> None:
    merged = scene_of(turning(PLATE), HOUSE)
    now, then = (traced(merged, pose).specular for pose in (POSE, later(POSE)))
    assert len(now) == len(then) >= 1
    np.testing.assert_allclose(now.image_velocity, (then.image - now.image) / STEP_S, atol=5e-3)


def test_chains_of_mirrors_have_the_range_rate_of_two_traces() -> None:
    wide = plate("wide", (8.0, 0.0, 0.0), (0.0, 16.0, 0.0), (0.0, 0.0, 3.0), "metal")
    merged = scene_of(
        turning(wide, yaw=-TURN_DEG_PER_S), plate("side", (5.0, 9.0, 0.0), (9.0, 0.0, 0.0), (0.0, 0.0, 9.0), "metal")
    )
    now, then = (traced(merged, pose, depth=2).specular for pose in (POSE, later(POSE, 1e-3)))
    assert now.depth.max() == 2
    assert len(now) == len(then)
    rate = np.einsum("ki,ki->k", now.image, now.image_velocity) / np.linalg.norm(now.image, axis=1)
    lengths = [np.sort(np.linalg.norm(table.image, axis=1)) for table in (now, then)]
    order = np.argsort(np.linalg.norm(now.image, axis=1))
    # The solver's float32 vertices are good to some micrometres.
    np.testing.assert_allclose(rate[order], (lengths[1] - lengths[0]) / 1e-3, atol=0.05)


def test_what_scatters_on_a_turning_body_moves_with_its_point() -> None:
    rough = {**MATERIALS.entries}
    metal, source = rough["metal"]
    rough["metal"] = (type(metal)(**{**vars(metal), "scattering_coefficient": 0.6}), source)
    materials = type(MATERIALS)(entries=rough, unknown=())
    paths = traced(scene_of(turning(CAR), materials=materials), POSE, specular=False).scattered
    assert len(paths) > 100
    hub = np.array([8.0 + 3.0 * POSE.time_s, 0.0, 0.0])
    spin = np.array([0.0, 0.0, np.radians(TURN_DEG_PER_S)])
    expected = np.array([3.0, 0.0, 0.0]) + np.cross(spin, paths.rx_point - hub) - POSE.velocity
    np.testing.assert_allclose(paths.rx_velocity, expected, atol=1e-6)
    np.testing.assert_allclose(paths.tx_velocity, expected, atol=1e-6)


def test_the_speckle_of_a_turning_body_turns_with_it() -> None:
    """The same ray lattice, in the body's own frame, meets the same cells of the surface: the same phases."""
    merged = scene_of(turning(CAR, yaw=90.0, forward=0.0)).at(1.0)
    triangle = np.arange(len(merged.meshes[0].triangles))
    corners = merged.meshes[0].vertices[merged.meshes[0].triangles]
    carried = merged.carried(triangle, corners.mean(axis=1), np.zeros(len(triangle), dtype=np.int64))
    at_rest = CAR.vertices[CAR.triangles].mean(axis=1)
    np.testing.assert_allclose(carried.at_rest, at_rest, atol=1e-12)


def test_edges_of_a_turning_body_move_as_two_moments_say_and_others_are_kept() -> None:
    merged = scene_of(turning(CAR), HOUSE)
    now, then = (edges_of(merged.at(time)) for time in (0.2, 0.2 + STEP_S))
    house = np.array([merged.objects[index] == "house" for index in now.object_index])
    assert house.any()
    assert (~house).any()
    for share in (0.0, 0.3, 1.0):
        here, there = (edges.start + share * (edges.end - edges.start) for edges in (now, then))
        velocity = now.velocity_at(np.arange(len(now)), here)
        np.testing.assert_allclose(velocity, (there - here) / STEP_S, atol=1e-3)
    np.testing.assert_array_equal(now.velocity[house], 0.0)


def test_corners_of_a_turning_body_have_the_range_rate_of_two_traces() -> None:
    """One 3 m from the middle of its long body: the mean velocity of the mesh would be 7 Doppler cells off."""
    bed = plate("bed", (7.0, 3.0, -0.5), (1.0, 0, 0), (0, 1.0, 0), "metal")
    wall = plate("wall", (8.0, 3.0, 0.5), (0, 1.0, 0), (0, 0, 1.0), "metal")
    far = plate("far", (8.5, -3.0, 0.5), (0.2, 1.0, 0), (0, 0, 1.0), "metal")
    merged = scene_of(*(turning(item, forward=0.0) for item in (bed, wall, far)))
    poses = [Pose((0.0, 3.0, 0.3), time_s=time) for time in (0.0, 1e-5)]
    now, then = (
        table.take(table.kinds & CORNER > 0)
        for table in (traced(merged, pose, depth=1, corners=True).specular for pose in poses)
    )
    assert len(now) == len(then) > 0
    rate = 0.5 * np.einsum("ki,ki->k", now.image, now.image_velocity) / np.linalg.norm(now.image, axis=1)
    np.testing.assert_allclose(rate, (then.range_m() - now.range_m()) / 1e-5, atol=2e-3)
    assert np.abs(rate).min() > 1.5


@pytest.mark.parametrize(
    ("shape", "yaw"), [(sphere(0.33, 48), 1200.0), (tube(20.0, 2.0, 40, start=np.pi - 0.4, turn=0.8), 40.0)]
)
def test_curved_mirrors_of_a_turning_body_move_as_two_traces_say(shape: Mesh, yaw: float) -> None:
    """A ball that spins in place moves nothing; a bent wall turns the way to its mirror image."""
    vertices, triangles = shape
    middle = 28.0 if yaw == 40.0 else 8.0
    item = mesh("body", vertices + np.array([middle, 0.0, 0.0]), triangles, "metal")
    merged = scene_of(turning(item, yaw=yaw, forward=0.0))
    poses = [Pose((0.0, 0.3 if yaw == 40.0 else 0.0, 0.0), time_s=time) for time in (0.0, 1e-4)]
    now, then = (traced(merged, pose, depth=1, diffuse=False).scattered for pose in poses)
    assert len(now) == len(then) == 1
    for side in ("tx", "rx"):
        moved = (getattr(then, f"{side}_point") - getattr(now, f"{side}_point")) / 1e-4
        np.testing.assert_allclose(getattr(now, f"{side}_velocity"), moved, atol=0.05)


def test_boundaries_of_mirrors_that_rest_are_those_of_time_0() -> None:
    merged = scene_of(turning(CAR), HOUSE)

    def rims(at: MergedScene, turned: bool) -> Rim:
        """Of the first triangle of what turns, or of what does not."""
        mesh = np.flatnonzero(at.turned == turned)[0]
        (body,) = (body for body in bodies_of(at) if mesh in body.meshes)
        return planes_of(body).rim(at.first[mesh], at.corners[at.first[mesh], 0], at.normals[at.first[mesh]])[0]

    assert rims(merged.at(0.7), False) is rims(merged, False)
    assert np.abs(rims(merged.at(0.7), True).edges - rims(merged, True).edges).max() > 0.1


def test_a_scene_at_rest_is_itself_at_all_times() -> None:
    merged = scene_of(HOUSE)
    assert merged.at(5.0) is merged
    assert edges_of(merged.at(5.0)) is edges_of(merged)


def test_a_shifted_scene_keeps_its_shape_and_shares_what_was_found_of_it() -> None:
    track = Track((0.0, 1.0), ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0)), ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    car = SceneObject("car", CAR.vertices, CAR.triangles, "metal", motion=track).as_it_moves()
    lid = SceneObject(
        "lid", CAR.vertices + np.array([0.0, 0.0, 2.0]), CAR.triangles, "glass", motion=track
    ).as_it_moves()
    merged = scene_of(car, lid, HOUSE)
    there = merged.at(0.5)
    assert bodies_of(there) is bodies_of(merged)
    assert there.shapes is merged
    by_material = {mesh.object_of_triangle[0]: mesh for mesh in there.meshes}
    assert by_material[0].rigid_body == by_material[1].rigid_body != by_material[2].rigid_body
    np.testing.assert_array_equal(by_material[0].shift, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(by_material[0].velocity, [2.0, 0.0, 0.0])
    np.testing.assert_array_equal(merged.at(3.0).meshes[0].velocity, [0.0, 0.0, 0.0])
    assert merged.fastest_mps == 2.0
