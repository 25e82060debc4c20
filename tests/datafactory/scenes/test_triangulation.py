"""Polygons to triangles: concave ones, holes, outlines that cross themselves."""

from __future__ import annotations

import numpy as np
import pytest

from datafactory.scenes.readers.usd_prims import triangulate


def test_concave_polygons_keep_their_area_and_outline() -> None:
    """An L of area 3: a fan from its corner 0 would cover 4 and stick out into the yard."""
    outline = np.array([[2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0], [0, 0, 0]], dtype=np.float64)
    for start in range(6):
        points = np.roll(outline, start, axis=0)
        cut = triangulate(points, np.array([6]), np.arange(6))
        corner = points[cut.triangles]
        doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (doubled[:, 2] > 0).all()
        assert doubled[:, 2].sum() / 2 == pytest.approx(3.0)
        assert cut.crossing_faces == 0
        middle = corner.mean(axis=1)
        assert not ((middle[:, 0] > 1) & (middle[:, 1] > 1)).any()


def test_a_hole_joined_by_a_doubled_edge_stays_open() -> None:
    outer, inner = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
    ring = [*outer, outer[0], inner[0], *inner[1:], inner[0]]
    points = np.array([(x, y, 0.0) for x, y in ring])
    cut = triangulate(points, np.array([len(ring)]), np.arange(len(ring)))
    corner = points[cut.triangles]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.abs(doubled[:, 2]).sum() / 2 == pytest.approx(16 - 4)


def test_a_bow_tie_is_counted() -> None:
    points = np.array([[0, 0, 0], [2, 3, 0], [2, 0, 0], [0, 2, 0]], dtype=np.float64)
    assert triangulate(points, np.array([4]), np.arange(4)).crossing_faces == 1


def test_bad_faces_are_counted_and_the_others_keep_their_numbers() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    cut = triangulate(points, np.array([2, 4, 3, 3]), np.array([0, 1, 0, 1, 2, 3, 0, 1, 9, 0, 1, 2]))
    assert cut.bad_faces == 2
    assert cut.faces.tolist() == [1, 1, 3]
