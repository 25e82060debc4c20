"""Right-angled corners of small meshes, counted and measured by hand; of scenes in which something turns."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest
from corner_scenes import corners_seen, dihedral, meshes_of
from numpy.typing import NDArray
from sionna_scenes import box, mesh, plate, scene_of
from turning_scenes import merged_of, turning

from datafactory.paths import corners
from datafactory.paths.bodies import Body
from datafactory.paths.corners import CornerEdges, corners_of, points_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.planes import TOUCH_M, PlanarFaces, planar_faces_of
from datafactory.scenes.poses import Pose

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


def edges_anew(scene: MergedScene) -> CornerEdges:
    found = inspect.unwrap(corners._found_edges)(replace(scene, at_rest=None))
    return found.moving_with(scene, found.face_mesh[:, 0])


@pytest.mark.parametrize("time_s", [0.0, 0.7])
@pytest.mark.parametrize("of", SCENES)
def test_edges_of_kept_bodies_are_those_found_anew(of: str, time_s: float) -> None:
    scene = merged_of(*SCENES[of]).at(time_s)
    found, whole = corners_of(scene), edges_anew(scene)
    assert len(found) > 0
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
    scene = merged_of(*SCENES[of]).at(0.7)
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
    scene = merged_of(*SCENES["some of it turns"])
    corners_of(scene.at(0.3))
    corners_of(scene.at(0.9))
    assert [bool(scene.turned[list(body.meshes)].any()) for body in searched].count(True) == 4  # car and truck, twice
    assert len(searched) == 4 + 2  # house and shed, once
