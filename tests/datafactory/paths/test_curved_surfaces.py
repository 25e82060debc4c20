"""Which facets sample a curved surface, which stay flat, and what a run says of them."""

from dataclasses import replace

import numpy as np
import pytest
from curved_scenes import body, capsule, cylinder, ellipsoid, grid, icosphere, rounded_box, sphere, traced
from path_tables import different_columns
from scipy.spatial.transform import Rotation
from sionna_scenes import mesh, plate, scene_of

from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import edges_of

pytestmark = pytest.mark.usefixtures("variant")


@pytest.mark.parametrize("of", [sphere(0.5, 16), icosphere(0.5, 2), capsule(0.3, 1.0, 16)])
def test_folds_of_a_curved_surface_do_not_diffract(of):
    """At 22.5 deg they would be edges, were they not of a smooth surface."""
    assert len(edges_of(scene_of(body(of, (6.0, 0.0, 0.0))))) == 0


def test_the_rim_of_a_cylinder_still_diffracts():
    assert len(edges_of(scene_of(body(cylinder(0.5, 1.0, 16), (6.0, 0.0, 0.0))))) == 2 * 16


def test_scenes_of_flat_faces_have_no_curved_surface_and_the_bytes_they_had(monkeypatch):
    box = rounded_box((1.0, 0.5, 0.5), 0.1, 3)  # 30 deg from facet to facet: a coarse one
    wall = plate("wall", (9.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 3.0), "metal")
    roof = mesh("roof", [[4, -2, 2], [6, -2, 2.3], [8, -2, 2], [4, 2, 2], [6, 2, 2.3], [8, 2, 2]],
                [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], "metal")  # fmt: skip
    objects = (body(box, (5.0, 1.0, 0.0)), wall, roof)
    assert len(curved_surfaces_of(scene_of(*objects))) == 0
    with_them = traced(*objects, depth=2, diffraction=True, refraction=True)
    nothing = replace(curved_surfaces_of(scene_of()), coarse=0)
    monkeypatch.setattr("datafactory.paths.curved_echoes.curved_surfaces_of", lambda merged: nothing)
    monkeypatch.setattr("datafactory.paths.view.curved_surfaces_of", lambda merged: nothing)
    without = traced(*objects, depth=2, diffraction=True, refraction=True)
    assert len(with_them.specular) > 1
    assert different_columns(with_them, without) == []


@pytest.mark.parametrize("segments", [8, 12, 14])
def test_coarse_bodies_stay_flat_and_the_scene_says_so(segments):
    merged = scene_of(body(cylinder(0.5, 1.0, segments), (6.0, 0.0, 0.0), Rotation.from_euler("z", 0.1)))
    surfaces = curved_surfaces_of(merged)
    assert (len(surfaces), surfaces.coarse) == (0, segments)
    assert any(f"{segments} facets" in note and "flat" in note for note in surfaces.notes())
    table = traced(body(cylinder(0.5, 1.0, segments), (6.0, 0.0, 0.0), Rotation.from_euler("z", 0.1)))
    assert table.counts["facets_too_coarse"] == segments
    assert "curved_mirrors" not in table.counts


def test_a_ragged_body_and_one_that_is_coarse_in_places_are_flat_throughout():
    generator = np.random.default_rng(7)
    vertices, triangles = icosphere(1.0, 1)
    ragged = vertices * (1.0 + generator.uniform(-0.2, 0.2, (len(vertices), 1)))
    for of in ((ragged, triangles), ellipsoid((2.2, 0.9, 0.7), 24)):
        surfaces = curved_surfaces_of(scene_of(body(of, (6.0, 0.0, 0.0))))
        assert len(surfaces) == 0
        assert surfaces.coarse > 0


def test_two_planes_with_a_low_ridge_and_a_crest_of_a_road_are_no_curved_surface():
    for heights in ((0.0, 0.3, 0.0), (0.0, 0.05, 0.06, 0.05)):
        x = np.arange(len(heights)) * 2.0
        rows = [[[a, b, h] for b in (-2.0, 2.0)] for a, h in zip(x, heights, strict=True)]
        assert len(curved_surfaces_of(scene_of(body(grid(np.array(rows)), (6.0, 0.0, 0.0))))) == 0


def test_a_panel_with_chamfers_is_no_curved_surface():
    """A car's tail: 1.7 x 0.6 m, with strips of 20 cm all round that lean by 20 deg."""
    low, high, y, z = 0.0, 0.2 * np.tan(np.radians(20.0)), 0.85, 0.3
    outer = [[high, a * (y + 0.2), b * (z + 0.2)] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    inner = [[low, a * y, b * z] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    sides = [[i, (i + 1) % 4, 4 + (i + 1) % 4] for i in range(4)] + [[i, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    tail = mesh("tail", np.array(outer + inner) + np.array([6.0, 0.0, 0.0]), [*sides, [4, 5, 6], [4, 6, 7]], "metal")
    assert len(curved_surfaces_of(scene_of(tail))) == 0
    assert len(traced(tail).specular) == 1


def test_noise_of_rounded_vertices_bends_no_wall():
    generator = np.random.default_rng(4)
    y, z = np.meshgrid(np.linspace(-3.0, 3.0, 40), np.linspace(-2.0, 2.0, 30), indexing="ij")
    wall = np.stack([6.0 + generator.uniform(-5e-4, 5e-4, y.shape), y, z], axis=-1)
    assert len(curved_surfaces_of(scene_of(body(grid(wall), (0.0, 0.0, 0.0))))) == 0
