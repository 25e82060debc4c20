"""One trace: the same bytes each time, names, hidden and small mirrors, empty views, places far from the origin."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from traced_walls import (
    rectangle,
    side_wall,
    traced,
    wall,
)

from datafactory.paths import solver as solver_module
from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

pytestmark = pytest.mark.usefixtures("variant")


def table_bytes(table: PathTable) -> bytes:
    return (
        b"".join(
            np.ascontiguousarray(getattr(kind, item.name)).tobytes()
            for kind in (table.scattered, table.specular)
            for item in fields(kind)
        )
        + repr((table.objects, table.counts)).encode()
    )


def test_same_arguments_same_bytes():
    scene = (wall("rough", half_m=20.0), side_wall("rough"))
    first, again = (traced(*scene, depth=2, rays=5_000) for _ in range(2))
    assert len(first.scattered) > 1000
    assert table_bytes(first) == table_bytes(again)
    assert table_bytes(first) != table_bytes(traced(*scene, depth=2, rays=5_000, fan=RayFan(5_000, (0.1, 0.2))))


def test_the_order_in_which_the_solver_returns_paths_does_not_matter(monkeypatch):
    # On a busy machine its threads finish in another order once in a while.
    scene = (wall("rough", half_m=20.0), side_wall("rough"))
    expected = table_bytes(traced(*scene, depth=2, rays=5_000))
    bundle_of = solver_module._bundle_of

    def shuffled(*arguments):
        bundle = bundle_of(*arguments)
        return bundle.take(np.random.default_rng(1).permutation(len(bundle.amplitude)))

    monkeypatch.setattr(solver_module, "_bundle_of", shuffled)
    assert table_bytes(traced(*scene, depth=2, rays=5_000)) == expected


def test_a_scene_far_from_its_origin_loses_nothing():
    shift = np.array([5e5, -5e5, 100.0])
    scene = (wall("rough", half_m=20.0), side_wall("mirror"))
    there = tuple(SceneObject(o.name, o.vertices + shift, o.triangles, o.material) for o in scene)
    pose = Pose((1.0, 0.5, 0.2), yaw_deg=20.0)
    far = Pose((5e5 + 1.0, -5e5 + 0.5, 100.2), yaw_deg=20.0)
    one, other = (traced(*s, pose=p, depth=2, rays=5_000) for s, p in ((scene, pose), (there, far)))
    assert len(one.scattered) == len(other.scattered) > 1000
    assert len(one.specular) == len(other.specular) > 0
    np.testing.assert_allclose(one.scattered.rx_point, other.scattered.rx_point, atol=1e-4)
    np.testing.assert_allclose(one.scattered.tx_point, other.scattered.tx_point, atol=1e-4)
    np.testing.assert_allclose(one.specular.image, other.specular.image, atol=1e-4)
    np.testing.assert_allclose(np.abs(one.scattered.amplitude), np.abs(other.scattered.amplitude), rtol=1e-3)


def test_merged_objects_keep_their_names():
    left = rectangle("left", (8.0, 2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
    right = rectangle("right", (8.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
    table = traced(right, left, rays=5_000)
    names = np.array(table.objects)[table.scattered.object_index]
    side = table.scattered.rx_point[:, 1]
    assert set(names) == {"left", "right"}
    assert (names[side > 0.0] == "left").all()
    assert (names[side < 0.0] == "right").all()


def test_an_empty_view_is_an_empty_table():
    behind = wall("rough", distance_m=-10.0)
    table = traced(behind)
    assert len(table) == 0
    assert table.counts["traced"] == table.counts["truncated"] == 0


def test_a_small_mirror_is_found_without_a_ray_on_it():
    plate = rectangle("plate", (50.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01), "mirror")
    table = traced(plate, rays=10)
    assert len(table.specular) == 1
    # A plate much smaller than the Fresnel zone: sigma = 4 pi A^2 / lambda^2, so that |a| = A / (4 pi R^2).
    assert abs(table.specular.amplitude[0]) == pytest.approx(0.02**2 / (4.0 * np.pi * 50.0**2), rel=2e-3)


def test_a_foot_on_the_diagonal_of_a_quad_counts_once():
    assert len(traced(wall("mirror")).specular) == 1


def test_a_hidden_mirror_is_counted_and_not_heard():
    blind = rectangle("blind", (5.0, 0.0, 0.0), (0.3, 1.0, 0.0), (0.0, 0.0, 1.0), "concrete")
    table = traced(wall("mirror"), blind)
    assert len(table.specular) == 0
    assert table.counts["mirrors_hidden"] == 1
