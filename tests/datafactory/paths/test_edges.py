"""The wedges of small meshes whose edges can be counted by hand."""

import numpy as np
import pytest
from sionna_scenes import mesh, plate, scene_of
from town_scenes import box

from datafactory.paths.edges import FLATTEST_FOLD_DEG, edges_of
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

UNIT_BOX = box("box", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "metal")


def apart(item: SceneObject) -> SceneObject:
    """The same triangles, none sharing a vertex, off by a hundredth of a millimetre here and there."""
    corners = item.vertices[item.triangles].reshape(-1, 3)
    jitter = np.random.default_rng(3).uniform(-1e-5, 1e-5, corners.shape)
    return mesh(item.name, corners + jitter, np.arange(len(corners)).reshape(-1, 3), item.material)


def fold(degrees: float, name: str = "fold") -> SceneObject:
    """Two squares that meet along y, the second bent down by so many degrees."""
    down = np.radians(degrees)
    far = [1.0 + np.cos(down), -np.sin(down)]
    vertices = [(0, 0, 0), (1, 0, 0), (far[0], 0, far[1]), (0, 1, 0), (1, 1, 0), (far[0], 1, far[1])]
    return mesh(name, vertices, [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], "metal")


@pytest.mark.parametrize("item", [UNIT_BOX, apart(UNIT_BOX)], ids=["shared vertices", "triangle soup"])
@pytest.mark.parametrize("wound", [1, -1], ids=["outward", "inward"])
def test_a_box_has_twelve_right_angled_edges(item, wound):
    turned = mesh("box", item.vertices, item.triangles[:, ::wound], "metal")
    edges = edges_of(scene_of(turned))
    assert len(edges) == 12
    np.testing.assert_allclose(edges.exterior_n, 1.5, atol=1e-4)
    middle = 0.5 * (edges.start + edges.end) - 0.5
    for normal in (edges.normal_0, edges.normal_n):
        np.testing.assert_allclose(np.einsum("ei,ei->e", normal, middle), 0.5, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(edges.end - edges.start, axis=1), 1.0, atol=1e-4)
    assert edges.counts == {
        "doubled_triangles": 0,
        "collapsed_triangles": 0,
        "edges": 12,
        "half_planes": 0,
        "merged": 0,
        "flat": 6,
        "non_manifold": 0,
    }


def test_the_frame_of_an_edge_is_right_handed():
    """Turning about the edge from into the 0-face over its normal, the n-face comes at n pi."""
    edges = edges_of(scene_of(UNIT_BOX, fold(40.0)))
    into_0 = np.cross(edges.normal_0, edges.direction)
    np.testing.assert_allclose(edges.direction, np.cross(into_0, edges.normal_0), atol=1e-12)
    angle = edges.exterior_n[:, None] * np.pi
    into_n = np.cos(angle) * into_0 + np.sin(angle) * edges.normal_0
    np.testing.assert_allclose(np.cross(into_n, edges.direction), edges.normal_n, atol=1e-12)
    np.testing.assert_allclose(edges.end - edges.start, edges.direction, atol=1e-9)  # every edge here is 1 m long


def test_roof_and_walls_of_different_materials_meet_in_wedges():
    faces = UNIT_BOX.triangles
    up = np.abs(UNIT_BOX.vertices[faces][:, :, 2] - 1.0).max(axis=1) < 1e-9
    roof, walls = (mesh(name, UNIT_BOX.vertices, faces[up == top], of) for name, top, of in
                   (("roof", True, "metal"), ("walls", False, "glass")))  # fmt: skip
    of = scene_of(roof, walls)
    edges = edges_of(of)
    assert len(edges) == 12
    eaves = np.abs(edges.start[:, 2] - 1.0) + np.abs(edges.end[:, 2] - 1.0) < 1e-9
    assert {of.meshes[i].material for i in edges.face_mesh[eaves].ravel()} == {"metal", "glass"}
    assert {of.meshes[i].material for i in edges.face_mesh[~eaves].ravel()} == {"glass"}


def test_a_sheet_ends_in_four_half_planes():
    edges = edges_of(scene_of(plate("sheet", (5.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 1.0), "glass")))
    assert len(edges) == edges.counts["half_planes"] == 4
    np.testing.assert_array_equal(edges.exterior_n, 2.0)
    np.testing.assert_allclose(edges.normal_0, -edges.normal_n, atol=1e-12)
    into = np.cross(edges.normal_0, edges.direction)
    middle = 0.5 * (edges.start + edges.end) - np.array([5.0, 0.0, 0.0])
    assert np.all(np.einsum("ei,ei->e", into, middle) < 0.0)


def test_pieces_of_one_line_are_one_edge():
    count = 7
    x = np.linspace(0.0, 3.0, count)
    lower, upper = (np.stack([x, 0.0 * x, z + 0.0 * x], axis=1) for z in (0.0, 1.0))
    steps = np.arange(count - 1)
    triangles = np.concatenate([np.stack([steps, steps + 1, steps + count + 1], axis=1),
                                np.stack([steps, steps + count + 1, steps + count], axis=1)])  # fmt: skip
    edges = edges_of(scene_of(mesh("strip", np.concatenate([lower, upper]), triangles, "metal")))
    assert len(edges) == 4
    assert edges.counts["merged"] == 2 * (count - 2)
    assert sorted(np.linalg.norm(edges.end - edges.start, axis=1)) == pytest.approx([1.0, 1.0, 3.0, 3.0])


def test_a_chain_that_bends_is_left_in_pieces():
    """Each joint is within the tolerance for straight, the whole is not."""
    bend = 8e-4 * np.arange(40)
    outer = np.cumsum(np.stack([np.cos(bend), np.sin(bend), 0.0 * bend], axis=1), axis=0)
    up = outer + np.array([0.0, 0.0, 1.0])
    steps = np.arange(39)
    triangles = np.concatenate([np.stack([steps, steps + 1, steps + 41], axis=1),
                                np.stack([steps, steps + 41, steps + 40], axis=1)])  # fmt: skip
    edges = edges_of(scene_of(mesh("curb", np.concatenate([outer, up]), triangles, "metal")))
    assert len(edges) == 2 * 39 + 2


@pytest.mark.parametrize(("degrees", "count"), [(FLATTEST_FOLD_DEG - 1.0, 6), (FLATTEST_FOLD_DEG + 1.0, 7)])
def test_flat_folds_are_left_out_and_counted(degrees, count):
    edges = edges_of(scene_of(fold(degrees)))
    assert len(edges) == count  # the rim has six pieces, those along x on either side of the fold
    assert edges.counts["flat"] == 2 + (7 - count)  # the squares' diagonals, and the fold
    if count == 7:
        assert sorted(edges.exterior_n)[0] == pytest.approx(1.0 + degrees / 180.0)


def test_edges_of_three_sheets_and_doubled_triangles_are_counted():
    sheets = [plate(f"s{i}", centre, across, (0.0, 0.0, 1.0), "metal") for i, (centre, across) in
              enumerate([((1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
                         ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))])]  # fmt: skip
    edges = edges_of(scene_of(*sheets, mesh("again", sheets[0].vertices, sheets[0].triangles[:, ::-1], "metal")))
    assert edges.counts["non_manifold"] == 1
    assert edges.counts["doubled_triangles"] == 2
    assert len(edges) == 7  # three rims each, and those of the two sheets in one plane are one


def test_bodies_that_move_apart_share_no_edge():
    halves = [plate("left", (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), "metal"),
              plate("right", (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal", (0.0, 3.0, 0.0))]  # fmt: skip
    edges = edges_of(scene_of(*halves))
    assert edges.counts["half_planes"] == 8
    names = np.array(scene_of(*halves).objects)[edges.object_index]
    np.testing.assert_array_equal(edges.velocity[:, 1], np.where(names == "right", 3.0, 0.0))


def test_the_radar_frame_is_the_poses():
    pose = Pose((10.0, 2.0, 0.5), yaw_deg=90.0, velocity=(1.0, 0.0, 0.0), time_s=2.0)
    of = scene_of(box("car", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "metal", (0.0, 4.0, 0.0)))
    edges, seen = edges_of(of), edges_of(of.at(pose.time_s)).seen_from(pose)
    np.testing.assert_allclose(seen.start, (edges.start + np.array([0.0, 8.0, 0.0]) - pose.position) @ pose.rotation())
    np.testing.assert_allclose(seen.velocity, np.tile([4.0, 1.0, 0.0], (12, 1)), atol=1e-12)
    np.testing.assert_allclose(seen.end - seen.start, seen.direction, atol=1e-12)
    assert edges_of(of) is edges  # found once


def test_edges_in_range_are_those_of_which_a_part_is():
    """Rims 3 m above and below, 12 m to the sides, at 4 m: nearest points at 5 m and 12.65 m."""
    edges = edges_of(scene_of(plate("wall", (4.0, 0.0, 0.0), (0.0, 12.0, 0.0), (0.0, 0.0, 3.0), "metal")))
    assert [len(edges.within(distance)) for distance in (4.9, 5.1, 12.6, 12.7)] == [0, 2, 2, 4]
