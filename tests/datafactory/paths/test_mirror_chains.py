"""Chains of mirrors: up to three, as soon as there is more than one bounce, whatever else is traced."""

from __future__ import annotations

import numpy as np
import pytest
from traced_walls import WAVELENGTH_M, rectangle, traced, wall

from datafactory.paths.solver import TraceSettings

AHEAD_M, BEHIND_M = 10.0, 6.0
THERE_AND_BACK_M = 2.0 * AHEAD_M + 2.0 * (AHEAD_M + BEHIND_M)
"""From the radar to the wall ahead, to that behind, ahead again, and home."""
WALLS = (wall("mirror", AHEAD_M), wall("mirror", -BEHIND_M, name="behind"))


@pytest.mark.parametrize("settings", [{}, {"diffuse": False}, {"refraction": True}, {"solver_share": 1}])
@pytest.mark.parametrize("depth", [2, 3])
def test_three_mirrors_are_followed_from_two_bounces_on(depth, settings):
    found = traced(*WALLS, depth=depth, **settings).specular
    third = found.take(found.depth == 3)
    assert len(third) == 1
    assert np.linalg.norm(third.image[0]) == pytest.approx(THERE_AND_BACK_M, rel=1e-6)
    assert abs(third.amplitude[0]) == pytest.approx(WAVELENGTH_M / (4.0 * np.pi * THERE_AND_BACK_M), rel=1e-2)
    assert found.depth.max() == 3


def test_few_rays_find_the_same_mirrors():
    every, few = (traced(*WALLS, depth=2, diffuse=False, rays=n).specular for n in (12_500, 1_000))
    np.testing.assert_allclose(few.amplitude, every.amplitude, rtol=1e-6)
    of_mirrors = TraceSettings().of_mirrors
    assert [of_mirrors.solver_rays(rays) for rays in (100, 20_000, 400_000)] == [100, 12_500, 100_000]


def test_single_bounces_have_no_chains():
    assert set(traced(*WALLS, depth=1).specular.depth) == {1}
    assert set(traced(*WALLS, depth=2, specular=False).specular.depth) == set()


def test_what_is_scattered_keeps_to_the_bounces_asked_for():
    rough = (wall("rough", AHEAD_M), rectangle("side", (5.0, 6.0, 0.0), (5.0, 0.0, 0.0), (0.0, 0.0, 9.0), "rough"))
    two, three = (traced(*rough, WALLS[1], depth=depth, rays=4_000) for depth in (2, 3))
    assert two.scattered.depth.max() == 2
    assert three.scattered.depth.max() == 3
    # The same chains of mirrors, whatever else is followed.
    np.testing.assert_array_equal(two.specular.amplitude, three.specular.amplitude)
    assert (two.specular.depth == 3).any()
