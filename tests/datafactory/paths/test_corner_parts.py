"""Corners of a scene in which something turns: those of what stands are kept, and all are those of a search anew."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sionna_scenes import box
from turning_scenes import merged_of, turning

from datafactory.paths import corner_edges, corner_points
from datafactory.paths.corner_edges import CornerEdges, corners_of
from datafactory.paths.corner_points import points_of
from datafactory.paths.merged_scene import MergedScene, motions_of

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
    found = inspect.unwrap(corner_edges._found)(replace(scene, at_rest=None))
    velocity, shift = motions_of(scene, found.face_mesh[:, 0])
    return replace(found, velocity=velocity, shift=shift)


@pytest.mark.parametrize("time_s", [0.0, 0.7])
@pytest.mark.parametrize("of", SCENES)
def test_edges_of_the_parts_are_those_of_the_whole(of: str, time_s: float) -> None:
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
def test_points_of_the_parts_are_those_of_the_whole(of: str) -> None:
    scene = merged_of(*SCENES[of]).at(0.7)
    found, whole = points_of(scene), inspect.unwrap(corner_points._found)(replace(scene, at_rest=None))
    velocity, shift = motions_of(scene, whole.face_mesh[:, 0])
    assert len(found) > 0
    assert found.counts == whole.counts
    whole = replace(whole, velocity=velocity, shift=shift)
    names = ("object_index", "face_mesh", "apex", "axes", "reach", "velocity", "shift")
    ours, theirs = (sorted_rows(*(getattr(table, name) for name in names)) for table in (found, whole))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_what_does_not_turn_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walker in a city does not have all its corners found anew in every frame."""
    searched: list[MergedScene] = []
    found = inspect.unwrap(corner_edges._found)

    def counted(scene: MergedScene) -> CornerEdges:
        searched.append(scene)
        return found(scene)

    monkeypatch.setattr(corner_edges, "_found", counted)
    scene = merged_of(*SCENES["some of it turns"])
    corners_of(scene.at(0.3))
    corners_of(scene.at(0.9))
    still, _, again, _ = searched
    assert still is again
    assert {mesh.turned for mesh in still.meshes} == {None}
