"""Corners in a whole trace: what is in sight, what the solver had found, and what adds nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from corner_scenes import corner_echo, dihedral, level_db, meshes_of, received
from sionna_scenes import FREQUENCY_HZ, box, scene_of

from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import CORNER, SPECULAR, PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.poses import Pose

pytestmark = pytest.mark.usefixtures("variant")

HERE = Pose((0.0, 0.0, 0.0))
RAYS = 20_000


def traced(*objects, pose: Pose = HERE, corners: bool = True, depth: int = 2) -> PathTable:
    settings = TraceSettings(rays=RAYS, depth=depth, diffuse=False, corners=corners)
    return trace(scene_of(*objects), pose, FREQUENCY_HZ, settings, RayFan(RAYS), seed=1)


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


@pytest.mark.parametrize("pose", [HERE, Pose((0.0, 3.0, 0.5), yaw_deg=-10.0), Pose((0.0, -6.0, 3.5), yaw_deg=20.0)])
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
