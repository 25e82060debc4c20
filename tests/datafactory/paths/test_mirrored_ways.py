"""Ways of targets over mirrors against mirror images and finite differences: lengths, Doppler, what hides them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from mirrored_scenes import (
    METAL,
    WAVELENGTH_M,
    echoes,
    fresnel,
    ground,
    point,
)
from numpy.typing import NDArray
from oracles import if_cube, mirrored, relative_error, scattered_delays

from datafactory.paths.mirrors import points_of_reflection
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, SceneObject
from datafactory.scenes.targets.models import Car, Pedestrian, Sphere, Trihedral
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

pytestmark = pytest.mark.usefixtures("variant")


def test_occlusion_of_either_leg_takes_its_paths() -> None:
    """A screen that stands in the bounced way but not in the direct one, before and behind the point of reflection."""
    for x, z in ((4.0, 0.15), (9.0, 0.4)):
        low = np.array([(x, -9.0, 0.0), (x, 9.0, 0.0), (x, 9.0, z), (x, -9.0, z)])
        screen = SceneObject("screen", low, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "mirror")
        target = [point((12.0, 0.0, 0.6))]
        paths, _ = echoes([ground(), screen], target, Pose((0.0, 0.0, 0.5)))
        free, _ = echoes([ground()], target, Pose((0.0, 0.0, 0.5)))
        lengths = paths.range_m()
        assert paths.depth.tolist().count(1) == 1
        bounced = np.linalg.norm([12.0, 1.1])
        over_ground = np.abs(lengths - bounced) < 1e-9
        assert not over_ground.any()
        assert (np.abs(free.range_m() - bounced) < 1e-9).sum() == 1


def test_a_target_that_is_hidden_directly_is_seen_over_a_wall() -> None:
    """Round a corner by a mirror: only the path that is reflected twice is there."""
    screen = SceneObject(
        "screen", np.array([(6.0, -9.0, -9.0), (6.0, 1.0, -9.0), (6.0, 1.0, 9.0), (6.0, -9.0, 9.0)]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "mirror",
    )  # fmt: skip
    side = SceneObject(
        "side", np.array([(-9.0, 4.0, -9.0), (30.0, 4.0, -9.0), (30.0, 4.0, 9.0), (-9.0, 4.0, 9.0)]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "mirror",
    )  # fmt: skip
    paths, table = echoes([screen, side], [point((12.0, 0.0, 0.0))], Pose((0.0, 0.0, 0.0)))
    assert table.counts["point_targets_hidden"] == 1
    assert paths.depth.tolist() == [3]
    np.testing.assert_allclose(paths.tx_point, [[12.0, 8.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(paths.rx_point, [[12.0, 8.0, 0.0]], atol=1e-9)


def turn(degrees: float, axis: int) -> NDArray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [k for k in range(3) if k != axis]
    found = np.eye(3)
    found[i, i] = found[j, j] = c
    found[i, j], found[j, i] = -s, s
    return found


TILTED = turn(4.0, 1) @ turn(-3.0, 0)
MOVING = {
    "target": ((-14.0, 2.0, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "radar": ((0.0, 0.0, 0.0), (9.0, -1.0, 0.0), (0.0, 0.0, 0.0)),
    "ground": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -0.6)),
    "all": ((-14.0, 2.0, 0.1), (9.0, -1.0, 0.0), (0.5, 0.0, -0.6)),
}


@pytest.mark.parametrize("moves", MOVING)
def test_delays_and_doppler_are_those_of_mirror_images_for_every_pair(moves: str) -> None:
    """A tilted moving ground, a turned moving radar, a moving target: each path of each TX and RX, over the frame."""
    target_velocity, radar_velocity, ground_velocity = (np.array(value) for value in MOVING[moves])
    sheet = ground(velocity=tuple(ground_velocity))
    sheet = replace(sheet, vertices=sheet.vertices @ TILTED.T)
    pose = Pose((0.0, 0.0, 0.5), yaw_deg=7.0, pitch_deg=-2.0, roll_deg=5.0, velocity=tuple(radar_velocity), time_s=0.3)
    start = np.array([14.0, 1.0, 2.5]) - 0.3 * target_velocity
    paths, _ = echoes([sheet], [point(tuple(start), tuple(target_velocity))], pose)
    assert sorted(paths.depth.tolist()) == [1, 2, 2, 3]
    rotation = pose.rotation()
    normal = TILTED @ np.array([0.0, 0.0, 1.0])
    generator = np.random.default_rng(3)
    for tx, rx in generator.uniform(-0.1, 0.1, (4, 2, 3)):

        def lengths(time_s: float, tx: NDArray = tx, rx: NDArray = rx) -> NDArray:
            """By images in the world: direct, over the mirror out, over it back, twice."""
            ends = [np.array(pose.position) + radar_velocity * time_s + rotation @ place for place in (tx, rx)]
            place = start + target_velocity * (0.3 + time_s)
            image = mirrored(place, (ground_velocity * (0.3 + time_s), normal))
            ways = [[np.linalg.norm(end - seen) for seen in (place, image)] for end in ends]
            return np.sort([a + b for a in ways[0] for b in ways[1]])

        for time_s in (0.0, 5e-3, 1e-2):
            found = np.sort(scattered_delays(paths, tx, rx, time_s)) * 299_792_458.0
            np.testing.assert_allclose(found, lengths(time_s), rtol=0.0, atol=1e-10)
        step = 1e-3
        slope = (lengths(step) - lengths(-step)) / (2.0 * step)
        later, sooner = (np.sort(scattered_delays(paths, tx, rx, t)) * 299_792_458.0 for t in (step, -step))
        np.testing.assert_allclose((later - sooner) / (2.0 * step), slope, rtol=0.0, atol=1e-6)


def test_the_cube_has_all_four_paths_with_transmitters_in_turn() -> None:
    """TDM: synthesised against the slow sum of eq. (1), every TX at its own time."""
    waveform = Waveform(chirps=4, samples=128, range_bins=128, multiplexing="tdm", chirp_interval_s=300e-6)
    full = Radar()
    array = AntennaArray(tx_m=full.array.tx_m, rx_m=full.array.rx_m[::5])
    radar = full.model_copy(update={"waveform": waveform, "array": array})
    target = [point((7.0, 1.0, 0.7), (-9.0, 1.0, 0.0))]
    paths, table = echoes([ground()], target, Pose((0.0, 0.0, 0.5), velocity=(3.0, 0.0, 0.0)))
    table = PathTable(paths, objects=table.objects)
    assert len(paths) == 4
    assert relative_error(cube_of_paths(table, radar, 1e-6), if_cube(table, radar)) < 1e-6


def test_a_wall_beside_and_a_ground_below_give_every_way_out_with_every_way_back() -> None:
    side = SceneObject(
        "side", np.array([(-9.0, 4.0, 0.0), (30.0, 4.0, 0.0), (30.0, 4.0, 9.0), (-9.0, 4.0, 9.0)]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "mirror",
    )  # fmt: skip
    paths, table = echoes([ground(), side], [point((12.0, 0.0, 1.0))], Pose((0.0, 0.0, 0.5)))
    assert sorted(paths.depth.tolist()) == [1, 2, 2, 2, 2, 3, 3, 3, 3]
    assert table.counts["target_mirrors"] == 2


def test_a_wall_behind_the_target_gives_the_way_over_it_both_ways_and_counts_the_rest() -> None:
    """The bistatic angle of a mixed path is 180 deg there, where the monostatic cross section says nothing."""
    behind = SceneObject(
        "behind", np.array([(20.0, -9.0, -9.0), (20.0, 9.0, -9.0), (20.0, 9.0, 9.0), (20.0, -9.0, 9.0)]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "mirror",
    )  # fmt: skip
    paths, table = echoes([behind], [point((12.0, 0.3, 0.1))], Pose((0.0, 0.0, 0.0)))
    assert sorted(paths.depth.tolist()) == [1, 3]
    assert table.counts["target_mirrors_too_wide"] == 2


@pytest.mark.parametrize("pieces", [1, 2, 9])
def test_the_same_ground_in_pieces_is_the_same_echo(pieces: int) -> None:
    """Faces that share edges are one mirror, and a second sheet on top of it changes nothing."""
    cuts = np.linspace(-400.0, 400.0, pieces + 1)
    sheets = [ground(x=(a, b), name=f"g{k}") for k, (a, b) in enumerate(itertools.pairwise(cuts))]
    paths, table = echoes(sheets, [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)))
    whole, _ = echoes([ground()], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)))
    assert table.counts["target_mirrors"] == 1
    np.testing.assert_allclose(np.sort(np.abs(paths.amplitude)), np.sort(np.abs(whole.amplitude)), rtol=1e-6)
    doubled, table = echoes([ground(), ground(name="again")], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)))
    assert table.counts["target_mirrors"] == 1
    np.testing.assert_allclose(np.sort(np.abs(doubled.amplitude)), np.sort(np.abs(whole.amplitude)), rtol=1e-6)


def test_faces_on_top_of_each_other_are_one_mirror_to_the_radar_and_to_targets() -> None:
    """A poster half a millimetre before a wall, each of a body of its own; a board at 3 mm is a mirror of its own."""
    pose, target = Pose((0.0, 0.0, 0.0)), [point((6.0, 4.0, 0.3))]

    def upright(x: float, name: str, velocity: float) -> SceneObject:
        corners = np.array([(x, -9.0, -9.0), (x, 9.0, -9.0), (x, 9.0, 9.0), (x, -9.0, 9.0)])
        triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        return SceneObject(name, corners, triangles, "mirror", (velocity, 0.0, 0.0))

    wall, poster, board = upright(12.0, "wall", 0.0), upright(11.9995, "poster", -1.0), upright(11.997, "board", -1.0)
    paths, alone = echoes([wall], target, pose)
    doubled, both = echoes([wall, poster], target, pose)
    assert len(alone.specular) == len(both.specular) == 1
    assert both.objects[both.specular.object_index[0]] == "poster"  # it stands before the wall
    assert both.counts["target_mirrors"] == alone.counts["target_mirrors"] == 1
    np.testing.assert_allclose(np.abs(both.specular.amplitude), np.abs(alone.specular.amplitude), rtol=1e-3)
    np.testing.assert_allclose(np.sort(np.abs(doubled.amplitude)), np.sort(np.abs(paths.amplitude)), rtol=1e-3)
    _, before = echoes([wall, board], target, pose)
    assert before.counts["mirrors_hidden"] == 1
    assert [before.objects[index] for index in before.specular.object_index] == ["board"]


def test_a_models_aspect_is_that_towards_the_bisector() -> None:
    """A trihedral is seen by the mixed paths as from between radar and image, a sphere from its nearest points."""
    axes = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    corner = PointTarget("corner", (10.0, 0.0, 0.6), 0.0, model=Trihedral(0.1), axes=axes)
    paths, _ = echoes([ground()], [corner], Pose((0.0, 0.0, 0.5)))

    def section(direction: NDArray) -> float:
        turned = direction * [-1.0, -1.0, 1.0]
        return float(Trihedral(0.1).echoes(1e3 * turned, WAVELENGTH_M)[1][0])

    radar, image = (np.array([-10.0, 0.0, z - 0.6]) for z in (0.5, -0.5))
    radar, image = radar / np.linalg.norm(radar), image / np.linalg.norm(image)
    for depth, towards in ((1, radar), (2, radar + image), (3, image)):
        own = paths.take(paths.depth == depth)
        spread = np.linalg.norm(own.tx_point, axis=1) * np.linalg.norm(own.rx_point, axis=1)
        expected = WAVELENGTH_M * np.sqrt(section(towards / np.linalg.norm(towards))) / (4.0 * np.pi) ** 1.5
        gamma = abs(fresnel(METAL, np.array(1.1 / np.hypot(10.0, 1.1)), "V")) ** (depth - 1)
        np.testing.assert_allclose(np.abs(own.amplitude) * spread, gamma * expected, rtol=1e-3)
    ball = PointTarget("ball", (10.0, 0.0, 0.6), 0.0, model=Sphere(0.2))
    paths, _ = echoes([ground()], [ball], Pose((0.0, 0.0, 0.5)))
    twice = paths.take(paths.depth == 3)
    # Seen from the image of the radar, 0.5 m under the ground, the nearest point of the sphere.
    np.testing.assert_allclose(np.linalg.norm(twice.tx_point), np.hypot(10.0, 1.1) - 0.2, atol=1e-9)


def test_many_targets_and_their_points_keep_their_owners() -> None:
    targets = [
        PointTarget("car", (15.0, -3.0, 0.0), 11.25, model=Car()),
        PointTarget("post", (12.0, 1.0, 0.4), 0.0),
        PointTarget("human", (9.0, 2.0, 0.0), -1.4, model=Pedestrian()),
    ]
    paths, table = echoes([ground("asphalt")], targets, Pose((0.0, 0.0, 0.5)))
    names = np.array(table.objects)[paths.object_index]
    assert {name: int((names == name).sum()) for name in ("car", "post", "human")} == {"car": 20, "post": 4, "human": 4}


def test_points_of_reflection_are_those_of_mirror_images(generator: np.random.Generator) -> None:
    """Random triangles and points: the place lies on the plane, on the line to the image, and within."""
    corners = generator.uniform(-10.0, 10.0, (300, 3, 3))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    position = generator.uniform(-10.0, 10.0, (40, 3))
    place, triangle, foot = points_of_reflection(position, corners, normals)
    assert len(place) > 100
    for k, t, found in zip(place, triangle, foot, strict=True):
        image = mirrored(position[k], (corners[t, 0], normals[t]))
        length = np.linalg.norm(found) + np.linalg.norm(position[k] - found)
        assert length == pytest.approx(np.linalg.norm(image), rel=1e-9)
        weights = np.linalg.lstsq(np.vstack([corners[t].T, np.ones(3)]), np.append(found, 1.0), rcond=None)[0]
        assert (weights > -1e-6).all()
    # And none is missed: the same by barycentric coordinates, one by one.
    count = 0
    for k in range(40):
        for t in range(300):
            height = normals[t] @ corners[t, 0]
            above = normals[t] @ position[k] - height
            if height * above >= 0.0 or abs(height) < 0.01:
                continue
            image = position[k] - 2.0 * above * normals[t]
            hit = image * height / (normals[t] @ image)
            weights = np.linalg.lstsq(np.vstack([corners[t].T, np.ones(3)]), np.append(hit, 1.0), rcond=None)[0]
            count += bool((weights > 0.0).all())
    assert abs(count - len(place)) <= 1


def test_facets_of_a_curved_body_are_no_mirrors_of_a_target() -> None:
    """A smooth post beside the line of sight: whichever of its facets is square to the bisector reflects nothing."""
    turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.stack([5.0 + 0.5 * np.cos(turns), 1.0 + 0.5 * np.sin(turns)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(48, z)]) for z in (-2.0, 2.0)])
    faces = [(k, (k + 1) % 48, 48 + k) for k in range(48)]
    faces += [((k + 1) % 48, 48 + (k + 1) % 48, 48 + k) for k in range(48)]
    post = SceneObject("post", vertices, np.array(faces, dtype=np.int32), "mirror")
    _, table = echoes([post], [point((10.0, 0.0, 0.0))], Pose((0.0, 0.0, 0.0)))
    assert table.counts["target_mirrors"] == 0
