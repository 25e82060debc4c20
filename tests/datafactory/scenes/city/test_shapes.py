"""Surfaces that cities are made of: prisms, terraces, panes in frames."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from datafactory.scenes.city.shapes import Surface, framed_pane, prism, stepped_surface, welded


def as_mesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.triangles(), process=False)


def test_prism_volume_and_outward_normals() -> None:
    mesh = as_mesh(prism([(0, 0), (3, 0), (0, 2)], 1.0, 5.0, "metal"))
    assert mesh.volume == pytest.approx(12.0)


def test_stepped_surface_adds_the_kerb_to_the_flat_area() -> None:
    polygons = stepped_surface([0.0, 2.0, 5.0], [0.0, 4.0], [[0.0], [0.12]], lambda i, j: ("asphalt", "concrete")[i])
    mesh = as_mesh(welded(polygons))
    assert mesh.area == pytest.approx(5.0 * 4.0 + 0.12 * 4.0)
    kerb = np.isclose(mesh.face_normals[:, 0], -1.0)
    assert kerb.sum() == 2
    assert np.all(mesh.face_normals[~kerb, 2] > 0.99)
    assert [polygon.material for polygon in polygons].count("concrete") == 2


def test_framed_pane_lies_behind_its_outline_by_the_recess() -> None:
    outline = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 0.0, 1.0), (0.0, 0.0, 1.0)])  # normal -y
    panes = [item for item in framed_pane(outline, 0.1, 0.05, "wood", "glass") if item.material == "glass"]
    assert len(panes) == 1
    assert panes[0].corners == pytest.approx(
        np.array([(0.1, 0.05, 0.1), (1.9, 0.05, 0.1), (1.9, 0.05, 0.9), (0.1, 0.05, 0.9)])
    )
