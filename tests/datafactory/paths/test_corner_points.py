"""Corners against closed forms, rays followed one by one and counts by hand; what turns."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from corner_scenes import HERE, corners_seen, cross_section_dbsm, dihedral, level_db, meshes_of, received
from numpy.typing import NDArray
from oracles import corner_area
from sionna_scenes import WAVELENGTH_M, every_one, everything, mesh, plate, scene_of, slabs, turning, view_with
from town_scenes import box

from datafactory.paths import corners
from datafactory.paths.bodies import Body
from datafactory.paths.corner_echoes import CornerPointEchoes
from datafactory.paths.corners import CornerEdges, corners_of, points_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.planes import TOUCH_M, PlanarFaces, planar_faces_of
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import CORNER
from datafactory.scenes.poses import Pose

AXIS = np.array([[-1.0, np.sqrt(2.0) * np.sin(t), np.sqrt(2.0) * np.cos(t)] for t in np.radians([10.0, 130.0, 250.0])])
AXIS /= np.sqrt(3.0)
"""Three edges at right angles about -x."""


def rotated(yaw_deg: float, pitch_deg: float = 0.0):
    return Pose((0.0, 0.0, 0.0), yaw_deg=yaw_deg, pitch_deg=pitch_deg).rotation()


def trihedral(distance_m: float, legs_m: float, square: bool = False, turn=None, bend_rad: float = 0.0, cuts: int = 1):
    """Three faces about a point on the x axis.

    :param turn: rotation [3, 3] about the point; :param bend_rad: one edge is turned by this in the plane of another
    :param cuts: each triangle is cut into so many squared
    """
    edges = AXIS.copy()
    edges[2] = np.cos(bend_rad) * edges[2] + np.sin(bend_rad) * edges[1]
    edges = edges @ (np.eye(3) if turn is None else turn).T
    apex, objects = np.array([distance_m, 0.0, 0.0]), []
    for i in range(3):
        one, other = legs_m * edges[(i + 1) % 3], legs_m * edges[(i + 2) % 3]
        index: dict[tuple[int, int], int] = {}
        points: list[np.ndarray] = []
        triangles: list[list[int]] = []
        for s in range(cuts + 1):
            for t in range(cuts + 1 if square else cuts + 1 - s):
                index[s, t] = len(points)
                points.append(apex + s / cuts * one + t / cuts * other)
        for s, t in index:
            if (s + 1, t) in index and (s, t + 1) in index:
                triangles.append([index[s, t], index[s + 1, t], index[s, t + 1]])
                if (s + 1, t + 1) in index:
                    triangles.append([index[s + 1, t], index[s + 1, t + 1], index[s, t + 1]])
        objects.append(mesh(f"face-{i}", points, triangles, "metal"))
    return objects


def echoes(of: MergedScene, pose: Pose = HERE, sight=everything, polarization=("V", "V")):
    settings, points = TraceSettings(polarization=polarization), points_of(of).seen_from(pose)
    return every_one(CornerPointEchoes(view_with(slabs(of), sight, settings, corner_points=points)))


def section_dbsm(objects, distance_m: float) -> float:
    return cross_section_dbsm(received(echoes(scene_of(*objects))[:2]), distance_m)


@pytest.mark.parametrize("legs_m", [0.05, 0.1, 0.2])
@pytest.mark.parametrize(("square", "factor"), [(False, 4.0 / 3.0), (True, 12.0)], ids=["triangular", "square"])
def test_on_axis_far_away_it_has_its_cross_section(legs_m, square, factor):
    """4 pi a^4 / (3 lambda^2) and 12 pi a^4 / lambda^2, at 200 m."""
    expected = 10.0 * np.log10(factor * np.pi * legs_m**4 / WAVELENGTH_M**2)
    assert abs(section_dbsm(trihedral(200.0, legs_m, square), 200.0) - expected) < 0.3


@pytest.mark.parametrize("square", [False, True], ids=["triangular", "square"])
@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0.0, 0.0), (12.0, 0.0), (-8.0, 9.0)])
def test_off_axis_its_aperture_is_that_of_the_rays_that_come_back(square, yaw_deg, pitch_deg):
    turn, reach = rotated(yaw_deg, pitch_deg), np.max if square else np.sum
    objects = trihedral(500.0, 0.1, square, turn)
    cosines = AXIS @ turn.T @ [-1.0, 0.0, 0.0]
    area = corner_area(
        np.eye(3), lambda _, p: (p >= -1e-9).all(axis=1) & (reach(p, axis=1) <= 0.1), cosines, extent=0.2, count=800
    )
    expected = 10.0 * np.log10(4.0 * np.pi * area**2 / WAVELENGTH_M**2)
    assert abs(section_dbsm(objects, 500.0) - expected) < 0.3


def test_a_large_one_is_an_image_of_the_radar_inverted_in_its_point():
    scattered, specular, _ = echoes(scene_of(*trihedral(20.0, 5.0, True)))
    assert len(scattered) == 0
    np.testing.assert_allclose(specular.image, [[40.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(specular.axes, [-np.eye(3)], atol=1e-12)
    endless = WAVELENGTH_M / (8.0 * np.pi * 20.0)
    assert abs(level_db(specular.amplitude[0], endless)) < 0.3
    assert specular.kinds[0] == CORNER
    assert specular.depth[0] == 3


def test_every_polarisation_comes_back_turned_by_three_mirrors():
    """Metal turns E into -(1 - 2 n n) E; three such mirrors give E again, 90 deg late as from all that is small."""
    of = scene_of(*trihedral(30.0, 0.1))
    vertical, level, crossed = (received(echoes(of, polarization=which)[:2]) for which in ("VV", "HH", "VH"))
    assert level / vertical == pytest.approx(1.0, abs=0.01)
    assert abs(crossed / vertical) < 0.01
    assert np.angle(1j * vertical * np.exp(-4j * np.pi * 30.0 / WAVELENGTH_M)) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("cuts", [3, 10])
@pytest.mark.parametrize("square", [False, True], ids=["triangular", "square"])
def test_cut_otherwise_it_sends_the_same_echo(cuts, square):
    turn = rotated(7.0, -5.0)
    whole, pieces = (section_dbsm(trihedral(40.0, 0.15, square, turn, cuts=n), 40.0) for n in (1, cuts))
    assert abs(whole - pieces) < 0.01


def test_moved_by_500_km_it_sends_the_same_echo():
    still = section_dbsm(trihedral(40.0, 0.15), 40.0)
    shift = np.array([500_000.0, 5_480_000.0, 320.0])
    far = [mesh(item.name, item.vertices + shift, item.triangles, "metal") for item in trihedral(40.0, 0.15)]
    scattered, specular, _ = echoes(scene_of(*far), Pose(tuple(shift)))
    assert abs(cross_section_dbsm(received((scattered, specular)), 40.0) - still) < 0.01


def test_a_corner_that_is_off_square_is_left_out_and_counted():
    """Across legs of 0.2 m, 0.5 deg turn the phase by about a cycle; 0.005 deg do not."""
    for bend_deg, echo_count in ((0.005, 1), (0.5, 0)):
        scattered, specular, counts = echoes(scene_of(*trihedral(40.0, 0.2, bend_rad=np.radians(bend_deg))))
        assert len(scattered) + len(specular) == echo_count
        assert counts["corner_points_off_square"] == 1 - echo_count


def test_what_stands_before_it_hides_it_and_is_counted():
    _, _, counts = echoes(scene_of(*trihedral(40.0, 0.2)), sight=lambda start, end: np.zeros(len(end), dtype=bool))
    assert counts["corner_points_hidden"] == 1


def test_a_house_on_the_ground_has_points_inside_only():
    """Eight of the box; on the ground its lower four are those of the ground as well, and outside there is none."""
    house = box("house", (2.0, 2.0, 0.0), (6.0, 5.0, 3.0), "metal")
    assert len(points_of(scene_of(house))) == 8
    ground = plate("ground", (0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (0.0, 20.0, 0.0), "metal")
    points = points_of(scene_of(house, ground))
    inwards = [4.0, 3.5, 1.5] - points.apex
    assert (np.einsum("qi,qi->q", points.axes.sum(axis=1), inwards) > 0.0).all()


def test_a_room_corner_of_ground_and_two_walls_is_one_point():
    ground = plate("ground", (0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.0, 5.0, 0.0), "metal")
    one = plate("one", (5.0, 0.0, 1.5), (0.0, 5.0, 0.0), (0.0, 0.0, 1.5), "metal")
    other = plate("other", (0.0, 5.0, 1.5), (5.0, 0.0, 0.0), (0.0, 0.0, 1.5), "metal")
    points = points_of(scene_of(ground, one, other))
    np.testing.assert_allclose(points.apex, [[5.0, 5.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(np.sort(points.axes[0].sum(axis=0)), [-1.0, -1.0, 1.0], atol=1e-9)
    assert len(points_of(scene_of(ground, one))) == 0
    assert len(points_of(scene_of())) == 0


GROUND = plate("ground", (0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (0.0, 20.0, 0.0), "metal")


def wall(low: float, high: float, x: float = 5.0, velocity=(0.0, 0.0, 0.0)):
    return plate(
        "wall", (x, 0.0, 0.5 * (low + high)), (0.0, 3.0, 0.0), (0.0, 0.0, 0.5 * (high - low)), "metal", velocity
    )


def lengths(of) -> list[float]:
    low, high = corners_of(of).extent()
    return sorted(np.round(high - low, 6).tolist())


def test_two_faces_of_one_mesh_make_one_corner():
    one, other = meshes_of(dihedral(10.0, (0.3, 0.2), 0.5))
    corners = corners_of(scene_of(one, other))
    assert len(corners) == 1
    assert corners.opening[0] == pytest.approx(np.pi / 2, abs=1e-12)
    np.testing.assert_allclose(corners.strips[0, 2:], [0.3, 0.3, 0.2, 0.2], atol=1e-4)
    np.testing.assert_allclose(corners.strips[0, 1] - corners.strips[0, 0], 0.5, atol=1e-9)
    np.testing.assert_allclose(np.abs(corners.direction), [[0.0, 0.0, 1.0]], atol=1e-12)
    for face, normal in zip(corners.into[0], corners.normal[0, ::-1], strict=True):
        np.testing.assert_allclose(face, normal, atol=1e-12)  # at a right angle each is the other's
    assert corners.counts == {"right_angles": 1, "corner_edges": 1}


@pytest.mark.parametrize("foot_m", [0.0, 0.9 * TOUCH_M, -0.5])
def test_a_sheet_on_the_ground_or_in_it_makes_a_corner_on_either_side(foot_m):
    corners = corners_of(scene_of(GROUND, wall(foot_m, 2.0)))
    above = corners.take(corners.into[:, :, 2].max(axis=1) > 0.5)
    assert len(above) == 2
    assert len(corners) == (4 if foot_m < 0.0 else 2)
    reach = above.strips[:, 2:]
    np.testing.assert_allclose(np.sort(np.unique(np.round(reach, 6))), [2.0, 15.0, 25.0], atol=1e-5)


def test_a_house_on_the_ground_has_four_corners_outside_and_one_in_each_edge_inside():
    """Twelve edges look inwards, and four of the ground outwards; the ground's inner four lie over the house's own."""
    corners = corners_of(scene_of(GROUND, box("house", (2.0, 2.0, 0.0), (6.0, 5.0, 3.0), "metal")))
    outwards = corners.take(np.array([
        np.linalg.norm(o + i - [4.0, 3.5, 1.5]) > np.linalg.norm(o - [4.0, 3.5, 1.5])
        for o, i in zip(corners.origin, corners.into.sum(axis=1), strict=True)
    ]))  # fmt: skip
    assert len(outwards) == 4
    assert sorted(np.round(np.diff(np.stack(outwards.extent()), axis=0)[0], 6)) == [3.0, 3.0, 4.0, 4.0]


LEFT, RIGHT = (plate("w", (0.0, y, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), "metal") for y in (-1.0, 1.0))
UP = plate("up", (0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 0.5), "metal")
APART = [plate("w", (5.0, y, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal") for y in (-2.0, 2.0)]
NEEDLE = mesh("needle", [(5.0, -1.0, 0.0), (5.0, 1.0, 0.0), (5.0, 0.0, 0.0)], [[0, 1, 2]], "metal")
COUNTED = {
    "a wall that hovers": ((GROUND, wall(1.5 * TOUCH_M, 2.0)), []),
    "faces of no width": ((GROUND, NEEDLE), []),
    "a kerb of 4 mm": ((GROUND, wall(0.0, 0.004)), []),
    "a kerb of 10 cm": ((GROUND, wall(0.0, 0.1)), [6.0, 6.0]),
    "a ridge of three sheets, two of them in one plane": ((LEFT, RIGHT, UP), [2.0, 2.0]),
    "an edge with a gap": ((GROUND, *APART), [2.0] * 4),
    "bodies that move apart": ((GROUND, wall(0.0, 2.0, velocity=(1.0, 0.0, 0.0))), []),
}
"""Small scenes, and the lengths of their corners [m]."""


@pytest.mark.parametrize("name", COUNTED)
def test_corners_of_small_scenes_are_counted_by_hand(name):
    objects, expected = COUNTED[name]
    assert lengths(scene_of(*objects)) == expected


def test_a_triangular_face_gives_a_strip_that_narrows():
    gable = mesh("gable", [(5.0, -2.0, 0.0), (5.0, 2.0, 0.0), (5.0, 0.0, 3.0)], [[0, 1, 2]], "metal")
    corners = corners_of(scene_of(GROUND, gable))
    one = corners.take(np.array([0]))
    assert len(one.strips) == 2
    wall_face = int(np.abs(one.into[0, :, 2]).argmax())
    reach = one.strips[:, [2 + 2 * wall_face, 3 + 2 * wall_face]]
    np.testing.assert_allclose(reach, [[0.0, 3.0], [3.0, 0.0]], atol=1e-4)


def test_a_corner_of_bodies_that_move_together_moves_as_they_do():
    moving = [plate(name, centre, across, up, "metal", (1.0, 0.0, 0.0)) for name, centre, across, up in
              (("a", (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
               ("b", (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))]  # fmt: skip
    corners = corners_of(scene_of(*moving))
    np.testing.assert_array_equal(corners.velocity, [[1.0, 0.0, 0.0]])


def test_corners_of_a_body_are_seen_where_it_is_then():
    of = scene_of(*meshes_of(dihedral(10.0, 0.3, 0.5)))
    seen = corners_seen(of, Pose((1.0, 2.0, 0.5), yaw_deg=90.0, velocity=(2.0, 0.0, 0.0)))
    foot = seen.origin + np.array([0.0, 0.0, 0.5]) @ Pose((0.0, 0.0, 0.0), yaw_deg=90.0).rotation()
    np.testing.assert_allclose(foot[0, :2], [-2.0, -9.0], atol=1e-9)
    np.testing.assert_allclose(seen.velocity, [[0.0, 2.0, 0.0]], atol=1e-9)


HOUSE = box("house", (20.0, -9.0, -1.0), (25.0, 9.0, 8.0), "metal")
SHED = replace(box("shed", (2.0, 5.0, 0.0), (4.0, 7.0, 2.0), "metal"), velocity=(1.0, 0.0, 0.0))
CAR, TRUCK = (box(name, (7.0, y - 2.0, -1.0), (9.0, y + 2.0, 1.0), "metal") for name, y in (("car", 0), ("truck", 9)))
SCENES = {
    "some of it turns": (turning(CAR), HOUSE, turning(TRUCK, "other", 25.0), SHED),
    "all of it turns": (turning(CAR), turning(TRUCK, "other", 25.0)),
    "nothing turns": (HOUSE, SHED),
}


def sorted_rows(*columns: NDArray) -> NDArray[np.float64]:
    """[n, ...] the columns side by side, in an order that does not depend on theirs."""
    rows = np.concatenate([np.reshape(column, (len(column), -1)) for column in columns], axis=1)
    return np.asarray(rows[np.lexsort(np.round(rows, 5).T)], dtype=np.float64)


@pytest.mark.parametrize("time_s", [0.0, 0.7])
@pytest.mark.parametrize("of", SCENES)
def test_edges_of_kept_bodies_are_those_found_anew(of: str, time_s: float) -> None:
    scene = scene_of(*SCENES[of]).at(time_s)
    found, whole = corners_of(scene), inspect.unwrap(corners._found_edges)(replace(scene, at_rest=None))
    assert len(found) > 0
    whole = whole.moving_with(scene, whole.face_mesh[:, 0])
    assert found.counts == whole.counts

    def rows(table: CornerEdges) -> NDArray[np.float64]:
        start, end = (table.origin + along[:, None] * table.direction for along in table.extent())
        of_object, motion = (table.object_index, table.face_mesh), (table.velocity, table.shift)
        return sorted_rows(*of_object, start, end, table.into, table.normal, *motion)

    np.testing.assert_allclose(rows(found), rows(whole), atol=1e-9)
    triangles = np.arange(len(scene.mesh_of_triangle))
    pairs = (axis.ravel() for axis in np.meshgrid(triangles, triangles))
    one, other = pairs
    np.testing.assert_array_equal(found.joins(one, other), whole.joins(one, other))
    assert found.joins(one, other).any()


@pytest.mark.parametrize("of", SCENES)
def test_points_of_kept_bodies_are_those_found_anew(of: str) -> None:
    scene = scene_of(*SCENES[of]).at(0.7)
    found, whole = points_of(scene), inspect.unwrap(corners._found_points)(replace(scene, at_rest=None))
    assert len(found) > 0
    assert found.counts == whole.counts
    whole = whole.moving_with(scene, whole.face_mesh[:, 0])
    names = ("object_index", "face_mesh", "apex", "axes", "reach", "velocity", "shift")
    ours, theirs = (sorted_rows(*(getattr(table, name) for name in names)) for table in (found, whole))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_what_does_not_turn_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walker in a city does not have all its corners found anew in every frame."""
    searched: list[Body] = []

    def counted(body: Body) -> PlanarFaces:
        searched.append(body)
        return planar_faces_of(body)

    monkeypatch.setattr(corners, "planar_faces_of", counted)
    scene = scene_of(*SCENES["some of it turns"])
    corners_of(scene.at(0.3))
    corners_of(scene.at(0.9))
    assert [bool(scene.turned[list(body.meshes)].any()) for body in searched].count(True) == 4  # car and truck, twice
    assert len(searched) == 4 + 2  # house and shed, once
