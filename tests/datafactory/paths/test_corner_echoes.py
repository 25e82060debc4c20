"""Echoes of right-angled corners against closed forms and physical optics; in a whole trace, what adds nothing."""

from dataclasses import replace

import numpy as np
import pytest
from corner_scenes import (
    Rectangle,
    Sight,
    corner_echo,
    corners_seen,
    cross_section_dbsm,
    dihedral,
    echoes,
    level_db,
    meshes_of,
    received,
    reference_echo,
)
from numpy.typing import NDArray
from sionna_scenes import AT_ORIGIN, FREQUENCY_HZ, MATERIALS, WAVELENGTH_M, everything, scene_of, slab_reflection
from sionna_scenes import traced as trace_of
from town_scenes import box

from datafactory.paths import corner_echoes
from datafactory.paths.corner_aperture import Apertures
from datafactory.paths.table import CORNER, SPECULAR, PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject


@pytest.mark.parametrize(("across_m", "along_m"), [(0.1, 0.1), (0.05, 0.15), (0.2, 0.1), (0.3, 0.3)])
def test_a_dihedral_far_away_has_its_cross_section(across_m, along_m):
    """8 pi a^2 b^2 / lambda^2 on axis, at 100 m: from 2 D^2 / lambda on for all of these."""
    expected = 10.0 * np.log10(8.0 * np.pi * (across_m * along_m) ** 2 / WAVELENGTH_M**2)
    assert abs(cross_section_dbsm(corner_echo(dihedral(100.0, across_m, along_m)), 100.0) - expected) < 0.3


@pytest.mark.parametrize(("distance_m", "bound_db"), [(0.2, 1.0), (3.0, 1.0), (60.0, 0.3)])
@pytest.mark.parametrize("turned_deg", [-15.0, 0.0, 7.0, 15.0])
def test_level_and_phase_hold_from_twice_its_size_to_the_far_field(distance_m, bound_db, turned_deg):
    faces = dihedral(distance_m, 0.1, 0.1, turned_deg)
    ours, theirs = corner_echo(faces), reference_echo(faces)
    assert abs(level_db(ours, theirs)) < bound_db
    assert abs(np.angle(ours / theirs)) < np.radians(10.0)
    if distance_m == 60.0:  # far away the aperture, 2 a sin(45 deg - |turn|) wide, says how much it loses
        narrower = np.sin(np.radians(45.0 - abs(turned_deg))) / np.sin(np.radians(45.0))
        assert abs(level_db(ours, narrower * corner_echo(dihedral(60.0, 0.1, 0.1)))) < 0.1


def test_unequal_faces_end_where_the_shorter_one_does():
    for distance_m in (1.0, 30.0):
        faces = dihedral(distance_m, (0.08, 0.2), 0.1, 4.0)
        assert abs(level_db(corner_echo(faces), reference_echo(faces))) < 0.5


def test_the_lobes_along_the_edge_are_in_place_and_level():
    """A tilt of lambda / (2 b) is the first null, 1.1 deg here; differences count relative to the main lobe."""
    tilts = np.arange(0.0, 6.01, 0.2)
    ours = np.array([abs(corner_echo(dihedral(60.0, 0.1, 0.1, tilt_deg=tilt))) for tilt in tilts])
    theirs = np.array([abs(reference_echo(dihedral(60.0, 0.1, 0.1, tilt_deg=tilt))) for tilt in tilts])
    assert np.abs(ours - theirs).max() < 0.01 * theirs[0]
    lobes = [i for i in range(1, len(tilts) - 1) if theirs[i] > max(theirs[i - 1], theirs[i + 1])]
    assert len(lobes) >= 4
    assert np.abs(20.0 * np.log10(ours[lobes] / theirs[lobes])).max() < 1.0
    assert tilts[np.argmin(ours[:10])] == tilts[np.argmin(theirs[:10])] == pytest.approx(1.2, abs=0.11)


@pytest.mark.parametrize("opening_deg", [87.5, 89.7, 91.0, 92.5])
def test_off_a_right_angle_it_loses_what_the_integral_says(opening_deg):
    faces = dihedral(20.0, 0.1, 0.1, opening_deg=opening_deg)
    ours, theirs, whole = (corner_echo(faces), reference_echo(faces), reference_echo(dihedral(20.0, 0.1, 0.1)))
    assert abs(ours - theirs) < 0.05 * abs(whole)


@pytest.mark.parametrize("distance_m", [2.0, 6.0])
def test_a_wall_on_the_ground_seen_from_half_a_metre(distance_m):
    """A wall across the x axis, and the ground from it to beyond the sensor."""
    foot, aside = np.array([distance_m, -0.2, -0.5]), np.array([0.0, 0.4, 0.0])
    faces = [Rectangle(foot, aside, np.array(into)) for into in ((-1.5 * distance_m, 0.0, 0.0), (0.0, 0.0, 1.5))]
    assert abs(level_db(corner_echo(faces), reference_echo(faces, spacing_m=WAVELENGTH_M / 4.0))) < 0.3


def test_the_inner_corner_of_two_houses_is_an_image_of_the_radar():
    """Faces of 10 m and edges of 12 m at 40 m are endless: lambda / (4 pi 2 h), half of it in either order."""
    scattered, specular, _ = echoes(scene_of(*meshes_of(dihedral(40.0, 10.0, 12.0, 3.0, middle_m=4.0))))
    assert len(scattered) == 0
    assert len(specular) == 2
    endless = WAVELENGTH_M / (4.0 * np.pi * 80.0)
    assert abs(20.0 * np.log10(abs(specular.amplitude) / (0.5 * endless))).max() < 0.3
    assert abs(level_db(received((scattered, specular)), endless)) < 0.3
    np.testing.assert_allclose(specular.image, [[80.0, 0.0, 0.0]] * 2, atol=1e-9)
    np.testing.assert_allclose(specular.axes, [np.diag([-1.0, -1.0, 1.0])] * 2, atol=1e-12)
    np.testing.assert_allclose(specular.departure(), [[80.0, 0.0, 0.0]] * 2, atol=1e-9)
    assert set(specular.kinds) == {CORNER}
    assert set(specular.depth) == {2}


@pytest.mark.parametrize(("across_m", "law"), [(0.04, "scattered"), (2.0, "specular")])
@pytest.mark.parametrize("distance_m", [8.0, 20.0])
def test_the_law_of_the_delay_is_that_of_the_integral(across_m, law, distance_m):
    """Phase of every RX of the virtual sensor against the reference of its own TX and RX, half an array off."""
    faces = dihedral(distance_m, across_m, 0.1)
    scattered, specular, _ = echoes(scene_of(*meshes_of(faces)))
    assert (len(scattered) > 0) == (law == "scattered")
    spacing = WAVELENGTH_M / (8.0 if across_m < 1.0 else 3.0)
    for y in (0.05, 0.25):
        rx = np.array([0.0, y, 0.0])
        ratio = received((scattered, specular), rx=rx) / reference_echo(faces, rx=rx, spacing_m=spacing)
        assert abs(np.angle(ratio)) < np.radians(20.0), (y, np.degrees(np.angle(ratio)))


def test_polarisations_turn_as_two_mirrors_turn_them():
    """Upright metal edge: V comes back as +V, H as -H; an edge at 45 deg turns V into H."""
    upright = scene_of(*meshes_of(dihedral(20.0, 0.1, 0.1)))
    vertical, level, crossed = (
        received(echoes(upright, polarization=which)[:2]) for which in (("V", "V"), ("H", "H"), ("V", "H"))
    )
    assert level / vertical == pytest.approx(-1.0, abs=3e-3)
    assert abs(crossed / vertical) < 1e-9
    rolled = [received(echoes(upright, Pose((0.0, 0.0, 0.0), roll_deg=45.0), polarization=which)[:2])
              for which in (("V", "V"), ("V", "H"))]  # fmt: skip
    assert abs(rolled[0] / vertical) < 3e-3
    assert abs(rolled[1] / vertical) == pytest.approx(1.0, abs=3e-3)


def test_glass_reflects_with_both_of_its_coefficients():
    faces = dihedral(20.0, 0.1, 0.1, 10.0)
    metal, glass = (received(echoes(scene_of(*meshes_of(faces, of=of)))[:2]) for of in ("metal", "glass"))
    slab = MATERIALS["glass"]
    te, _ = slab_reflection(slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, FREQUENCY_HZ,
                            np.cos(np.radians([35.0, 55.0])))  # fmt: skip
    assert abs(glass / metal) == pytest.approx(abs(te[0] * te[1]), rel=3e-3)


def test_what_stands_in_the_way_takes_its_part_of_the_edge():
    """A curtain before the lower half of a tall corner: half of the image; before all of it: nothing."""
    tall = scene_of(*meshes_of(dihedral(20.0, 1.0, 8.0)))
    whole = received(echoes(tall)[:2])
    half = received(echoes(tall, sight=lambda start, end: end[:, 2] > 0.0)[:2])
    assert abs(half / whole - 0.5) < 0.05
    scattered, specular, counts = echoes(tall, sight=lambda start, end: np.zeros(len(end), dtype=bool))
    assert len(scattered) == len(specular) == 0
    assert counts["corners_hidden"] == 1


def test_a_moving_corner_has_the_doppler_of_the_turned_radar():
    """Image and point alike: the range changes by the velocity along the sight, the image's by twice that."""
    velocity = (-3.0, 1.0, 0.5)
    for size in (0.1, 3.0):
        parts = [SceneObject(part.name, part.vertices, part.triangles, part.material, velocity)
                 for part in meshes_of(dihedral(20.0, size, size))]  # fmt: skip
        scattered, specular, _ = echoes(scene_of(*parts))
        assert len(scattered) + len(specular) == 2
        for time_s in (1e-3, 10e-3):
            moved = [SceneObject(part.name, part.vertices + np.array(velocity) * time_s, part.triangles, "metal")
                     for part in parts]  # fmt: skip
            now, then = received((scattered, specular), time_s=time_s), received(echoes(scene_of(*moved))[:2])
            assert abs(np.angle(now / then)) < 0.05


CORNERS = [
    dihedral(20.0, 0.15, 0.2, 6.0),
    dihedral(12.0, (3.0, 0.4), 2.0, -20.0, middle_m=2.5),
    dihedral(6.0, (0.2, 5.0), 1.0, 25.0, 91.0, middle_m=-0.8, tilt_deg=4.0),
    dihedral(30.0, 8.0, 9.0),
]


@pytest.fixture
def apertures() -> Apertures:
    """Corners whose edges have the foot of the perpendicular and others, small, wide, unequal and off square."""
    faces = [item for n, faces in enumerate(CORNERS) for item in meshes_of(faces, cuts=2 + n)]
    facing, _ = corner_echoes._facing(corners_seen(scene_of(*faces)), WAVELENGTH_M)
    corners = corners_seen(scene_of(*faces)).take(facing)
    assert len(corners) >= len(CORNERS)
    return Apertures.of(np.arange(len(corners), dtype=np.int32), corners, WAVELENGTH_M)


def test_a_leg_behind_a_hidden_one_is_not_looked_at_and_nothing_else_changes(apertures) -> None:
    """Against both legs of every piece of both orders."""
    looked: list[NDArray[np.float64]] = []

    def recorded(sight: Sight) -> Sight:
        def look(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
            looked.append(end)
            return sight(start, end)

        return look

    def blinds(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.sin(40.0 * end[:, 2]) + np.sin(90.0 * end[:, 1]) > -0.4

    assert apertures.in_sight(recorded(everything)).pieces.all()
    legs, looked = looked, []
    fast = apertures.in_sight(recorded(blinds)).pieces
    slow = [blinds(one, one) & blinds(other, other) for one, other in (legs[:2], legs[2:])]
    np.testing.assert_array_equal(fast, np.reshape(slow, fast.shape))
    assert 0.1 < fast.mean() < 0.6
    assert sum(map(len, looked)) < 0.9 * sum(map(len, legs))


pytestmark = pytest.mark.usefixtures("variant")


def traced(*objects, pose: Pose = AT_ORIGIN, corners: bool = True, depth: int = 2) -> PathTable:
    return trace_of(scene_of(*objects), pose, rays=20_000, depth=depth, diffuse=False, corners=corners)


def of_corners(table: PathTable) -> PathTable:
    return replace(
        table,
        scattered=table.scattered.take(table.scattered.kinds & CORNER > 0),
        specular=table.specular.take(table.specular.kinds & CORNER > 0),
    )


def test_a_corner_in_plain_sight_is_seen_whole():
    faces = dihedral(20.0, 0.4, 0.5, 6.0)
    table = of_corners(traced(*meshes_of(faces)))
    assert abs(level_db(received((table.scattered, table.specular)), corner_echo(faces))) < 0.01


def test_a_box_before_it_hides_it():
    screen = box("screen", (10.0, -2.0, -2.0), (11.0, 2.0, 2.0), "metal")
    table = of_corners(traced(*meshes_of(dihedral(20.0, 0.4, 0.5, 6.0)), screen))
    assert len(table) == 0
    assert table.counts["corners_hidden"] >= 1


@pytest.mark.parametrize(
    "pose", [AT_ORIGIN, Pose((0.0, 3.0, 0.5), yaw_deg=-10.0), Pose((0.0, -6.0, 3.5), yaw_deg=20.0)]
)
def test_convex_edges_add_nothing(pose):
    table = of_corners(traced(box("house", (15.0, -3.0, -1.0), (22.0, 4.0, 2.0), "metal"), pose=pose))
    assert len(table) == 0


@pytest.mark.parametrize("opening_deg", [60.0, 120.0])
def test_other_angles_add_nothing_and_lose_nothing(opening_deg):
    """A corner of 60 deg has mirror paths of three bounces, which stay what they are."""
    faces = meshes_of(dihedral(20.0, 6.0, 4.0, 7.0, opening_deg=opening_deg))
    with_them, without = (traced(*faces, corners=on, depth=3) for on in (True, False))
    assert len(of_corners(with_them)) == 0
    assert len(with_them) == len(without)
    np.testing.assert_array_equal(with_them.specular.amplitude, without.specular.amplitude)
    if opening_deg == 60.0:
        assert (with_them.specular.depth == 3).any()


@pytest.mark.parametrize("opening_deg", [88.5, 89.5, 89.99])
def test_what_the_solver_finds_of_a_corner_is_left_out(opening_deg):
    """An acute corner has mirror paths beside its edge; they are in the corner's own echo."""
    faces = meshes_of(dihedral(20.0, 3.0, 4.0, 5.0, opening_deg=opening_deg))
    with_them, without = traced(*faces), traced(*faces, corners=False)
    found = (without.specular.depth == 2) & (without.specular.kinds == SPECULAR)
    assert with_them.counts["corners_by_the_solver"] == found.sum()
    assert not ((with_them.specular.depth == 2) & (with_them.specular.kinds == SPECULAR)).any()


def test_beyond_the_limit_the_mirror_paths_take_over():
    """At 86.9 deg and 60 m the solver's two paths beside the edge have the level that the corner's have at 87.1 deg."""
    inside, outside = (
        traced(*meshes_of(dihedral(60.0, 9.0, 8.0, 2.0, opening_deg=opening))) for opening in (87.1, 86.9)
    )
    assert len(of_corners(outside)) == 0
    mirrors = outside.specular.take(outside.specular.depth == 2)
    corners = of_corners(inside).specular
    assert len(mirrors) == len(corners) == 2
    assert np.abs(20.0 * np.log10(np.sort(np.abs(mirrors.amplitude)) / np.sort(np.abs(corners.amplitude)))).max() < 1.0
    by_side = [paths.image[np.argsort(paths.image[:, 1])] for paths in (mirrors, corners)]
    assert np.linalg.norm(by_side[0] - by_side[1], axis=1).max() < 2.0 * 60.0 * np.radians(0.5)
