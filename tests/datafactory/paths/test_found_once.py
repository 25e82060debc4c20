"""What is found of a scene goes with it to other processes, and is not found there again."""

from __future__ import annotations

import pickle

import numpy as np
from prepared_scenes import EFFECT_SCENES, prepared_scene

from datafactory.paths.corner_edges import corners_of
from datafactory.paths.corner_points import points_of
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import edges_of
from datafactory.paths.solver import TraceSettings
from datafactory.paths.trace import find_shapes


def test_what_was_found_goes_along_and_is_the_same():
    scene = prepared_scene(EFFECT_SCENES / "three_faces.usda").merged
    find_shapes(scene, TraceSettings(corners=True, diffraction=True))
    copy = pickle.loads(pickle.dumps(scene))
    found = set(copy.found)
    pairs = [(find(copy), find(scene)) for find in (edges_of, corners_of, points_of, curved_surfaces_of)]
    assert set(copy.found) == found, "something was found again"
    assert min(len(points_of(scene)), len(corners_of(scene)), len(edges_of(scene))) > 0
    for own, other in pairs:
        for name, values in vars(other).items():
            assert np.array_equal(getattr(own, name), values), name


def test_another_time_of_a_scene_begins_with_nothing_found():
    scene = prepared_scene(EFFECT_SCENES / "moving_car.usda").merged
    find_shapes(scene, TraceSettings())
    assert scene.found
    assert scene.at(0.5).found == {}
