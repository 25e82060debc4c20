"""Targets over mirrors: levels against the two-ray model and a sum over a small face, ways against mirror images.

The closed form is written here from Fresnel's equations and lengths alone. It shares with what it judges
the scene's classes alone.
"""

from dataclasses import replace

import numpy as np
import pytest
from curved_scenes import tube
from mirrored_scenes import ASPHALT, METAL, echoes, fresnel, ground, level_db, point, two_rays_db
from numpy.typing import NDArray
from oracles import mirrored, scattered_delays
from sionna_scenes import WAVELENGTH_M, plate

from datafactory.frame.measurement import object_targets
from datafactory.paths.candidates import TARGET_SEEN
from datafactory.paths.feet import points_of_reflection
from datafactory.paths.table import SPECULAR, TARGET
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, SceneObject
from datafactory.scenes.targets.bodies import Sphere, Trihedral
from datafactory.scenes.targets.models import Car
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("variant")


def swept(of: str, range_m: NDArray, radar_m: float, target_m: float, polarization: str) -> NDArray:
    """Level over range of what is traced [dB]; all targets stand in one scene, told by their number."""
    targets = [replace(point((x, 0.0, target_m)), name=f"{k}") for k, x in enumerate(range_m)]
    pair = (polarization, polarization)
    paths, table = echoes([ground(of)], targets, Pose((0.0, 0.0, radar_m)), polarization=pair)
    first = len(table.objects) - len(targets)
    return np.array([level_db(paths.take(paths.object_index == first + k)) for k in range(len(targets))])


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("of", ["mirror", "asphalt"])
def test_the_lobes_over_range_are_those_of_the_two_ray_model(of: str, polarization: str) -> None:
    # 24 places for each lobe at 15 m, where they are closest.
    range_m = np.linspace(15.0, 60.0, 1000)
    spread_db = 40.0 * np.log10(range_m)
    found = swept(of, range_m, 0.5, 0.8, polarization) + spread_db
    expected = two_rays_db(METAL if of == "mirror" else ASPHALT, range_m, 0.5, 0.8, polarization) + spread_db
    # In a null the level is the difference of two nearly equal numbers: down to 40 dB below a peak it is compared.
    compared = expected > expected.max() - 40.0
    assert compared.mean() > 0.9
    np.testing.assert_allclose(found[compared], expected[compared], atol=0.1 if of == "mirror" else 0.5)

    def turns(levels: NDArray, sign: float) -> NDArray:
        inner = sign * levels[1:-1]
        return 1 + np.flatnonzero((inner > sign * levels[:-2]) & (inner > sign * levels[2:]))

    for sign in (1.0, -1.0):  # peaks, nulls
        ours, theirs = turns(found, sign), turns(expected, sign)
        assert len(theirs) >= 8
        assert len(ours) == len(theirs)
        assert np.abs(ours - theirs).max() <= 1


def test_four_paths_each_with_its_own_length_and_bounces() -> None:
    paths, table = echoes([ground()], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)))
    assert sorted(paths.depth.tolist()) == [1, 2, 2, 3]
    assert all(kinds == (TARGET if depth == 1 else TARGET | SPECULAR)
               for depth, kinds in zip(paths.depth, paths.kinds, strict=True))  # fmt: skip
    direct, bounced = np.sqrt(144.0 + 9.0 + 0.04), np.sqrt(144.0 + 9.0 + 1.44)
    expected = {1: direct, 2: 0.5 * (direct + bounced), 3: bounced}
    for depth, length in zip(paths.depth, paths.range_m(), strict=True):
        assert length == pytest.approx(expected[int(depth)], abs=1e-12)
    assert [name for name in np.array(table.objects)[paths.object_index]] == ["post"] * 4
    assert (table.counts["target_mirrors"], table.counts["target_mirrors_too_wide"]) == (1, 0)
    # The list of targets names each once, where it really stands.
    targets, counts = object_targets(table, len(table.objects) - 1, Radar())
    assert (len(targets), counts) == (1, {"targets_out_of_view": 0})
    behind = replace(table.scattered, rx_point=table.scattered.rx_point * [-1.0, 1.0, 1.0])
    targets, counts = object_targets(replace(table, scattered=behind), len(table.objects) - 1, Radar())
    assert (len(targets), counts) == (0, {"targets_out_of_view": 1})


@pytest.mark.parametrize(
    ("settings", "bounced"),
    [({"depth": 1}, 0), ({"specular": False}, 0), ({"depth": 3}, 3), ({"point_targets": False}, -1)],
)
def test_the_bounce_needs_second_bounces_mirrors_and_targets(settings: dict[str, object], bounced: int) -> None:
    paths, _ = echoes([ground()], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)), **settings)
    assert len(paths) == 1 + bounced


@pytest.mark.parametrize(
    ("along", "across"), [((-0.5, 0.5), (-0.06, 0.06)), ((-2.0, 0.3), (-0.2, 0.05)), ((-0.3, 0.2), (-0.02, 0.05))]
)
def test_a_small_face_reflects_what_the_sum_over_its_surface_does(
    along: tuple[float, float], across: tuple[float, float]
) -> None:
    """The slow reference: Kirchhoff's integral over the face, cell by cell, one way and both."""
    radar, place, centre = np.array([0.0, 0.0, 2.0]), np.array([24.0, 0.0, 4.0]), np.array([8.0, 0.0, 0.0])
    patch = ground(x=(8.0 + along[0], 8.0 + along[1]), y=across)
    paths, _ = echoes([patch], [point(tuple(place))], Pose(tuple(radar)))
    direct = abs(paths.amplitude[paths.depth == 1][0])
    twice = paths.amplitude[paths.depth == 3][0]
    x = centre[0] + np.linspace(*along, 3001)[:, None]
    y = np.linspace(*across, 601)[None, :]
    before, after = (np.sqrt((x - end[0]) ** 2 + y**2 + end[2] ** 2) for end in (radar, place))
    straight = np.hypot(24.0, 6.0)
    # (cos / lambda) int exp(-jk (r1 + r2)) / (r1 r2) dA over exp(-jk R) / R; an infinite plane has -j.
    cosine = 6.0 / straight
    waves = np.exp(-2j * np.pi * (before + after - straight) / WAVELENGTH_M) / (before * after)
    field = 1j * cosine / WAVELENGTH_M * straight * np.trapezoid(np.trapezoid(waves, y[0], axis=1), x[:, 0])
    gamma = fresnel(METAL, np.array(cosine), "V")
    free = direct * (24.0**2 + 4.0) / straight**2
    expected = np.conj((gamma * field) ** 2) * free
    # F fades edges over four Fresnel radii and takes lengths to second order: 2 % one way.
    assert abs(twice / expected - 1.0) < 0.05


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_a_wall_beside_is_a_ground_in_the_other_polarisation(polarization: str) -> None:
    """For a wall the field along z is across the plane of incidence: V has the lobes that H has above ground."""
    wall = plate("wall", (0.0, -0.5, 0.0), (400.0, 0.0, 0.0), (0.0, 0.0, 400.0), "asphalt")
    other = {"V": "H", "H": "V"}[polarization]
    for range_m in (15.0, 15.3, 15.6, 40.0):
        target = [point((range_m, 0.3, 0.0))]
        paths, _ = echoes([wall], target, Pose((0.0, 0.0, 0.0)), polarization=(polarization, polarization))
        expected = two_rays_db(ASPHALT, np.array([range_m]), 0.5, 0.8, other)[0]
        assert level_db(paths) == pytest.approx(expected, abs=0.05)


def test_occlusion_of_either_leg_takes_its_paths() -> None:
    """A screen that stands in the bounced way but not in the direct one, before and behind the point of reflection."""
    for x, z in ((4.0, 0.15), (9.0, 0.4)):
        screen = plate("screen", (x, 0.0, 0.5 * z), (0.0, 9.0, 0.0), (0.0, 0.0, 0.5 * z), "mirror")
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
    screen = plate("screen", (6.0, -4.0, 0.0), (0.0, 5.0, 0.0), (0.0, 0.0, 9.0), "mirror")
    side = plate("side", (10.5, 4.0, 0.0), (19.5, 0.0, 0.0), (0.0, 0.0, 9.0), "mirror")
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


def test_a_wall_beside_and_a_ground_below_give_every_way_out_with_every_way_back() -> None:
    side = plate("side", (10.5, 4.0, 4.5), (19.5, 0.0, 0.0), (0.0, 0.0, 4.5), "mirror")
    paths, table = echoes([ground(), side], [point((12.0, 0.0, 1.0))], Pose((0.0, 0.0, 0.5)))
    assert sorted(paths.depth.tolist()) == [1, 2, 2, 2, 2, 3, 3, 3, 3]
    assert table.counts["target_mirrors"] == 2


def test_a_wall_behind_the_target_gives_the_way_over_it_both_ways_and_counts_the_rest() -> None:
    """The bistatic angle of a mixed path is 180 deg there, where the monostatic cross section says nothing."""
    behind = plate("behind", (20.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 9.0), "mirror")
    paths, table = echoes([behind], [point((12.0, 0.3, 0.1))], Pose((0.0, 0.0, 0.0)))
    assert sorted(paths.depth.tolist()) == [1, 3]
    assert table.counts["target_mirrors_too_wide"] == 2


def test_faces_on_top_of_each_other_are_one_mirror_to_the_radar_and_to_targets() -> None:
    """A poster half a millimetre before a wall, each of a body of its own; a board at 3 mm is a mirror of its own."""
    pose, target = Pose((0.0, 0.0, 0.0)), [point((6.0, 4.0, 0.3))]

    def upright(x: float, name: str, velocity: float) -> SceneObject:
        return plate(name, (x, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 9.0), "mirror", (velocity, 0.0, 0.0))

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


def test_a_part_at_the_sensor_leaves_the_others_what_they_are() -> None:
    """Of a car's five points the first stands where the sensor is, or 2 cm below it."""
    car = PointTarget("car", (0.0, -1.0, 0.0), 11.25, model=Car())
    seen = []
    for height_m, points in ((0.8, 4), (0.82, 5)):
        paths, table = echoes([ground()], [car], Pose((0.0, 0.0, height_m)))
        assert (table.candidates.family == TARGET_SEEN).sum() == points
        twice = paths.take((paths.depth == 3) & (np.abs(paths.rx_point[:, 1]) > 0.5))
        seen.append(np.column_stack([twice.rx_point, 30.0 + 2.0 * np.log10(np.abs(twice.amplitude))]))
    at_sensor, beside = (rows[np.lexsort(np.round(rows[:, :3].T, 1))] for rows in seen)
    assert len(at_sensor) == 4
    np.testing.assert_allclose(at_sensor, beside, atol=0.08)


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
    vertices, triangles = tube(0.5, 4.0, 48)
    post = SceneObject("post", vertices + np.array([5.0, 1.0, 0.0]), triangles, "mirror")
    _, table = echoes([post], [point((10.0, 0.0, 0.0))], Pose((0.0, 0.0, 0.0)))
    assert table.counts["target_mirrors"] == 0
