"""The aperture of corners: what is summed or looked at once where a slower way would do it again."""

from __future__ import annotations

import numpy as np
import pytest
from corner_scenes import Sight, corners_seen, dihedral, meshes_of
from numpy.typing import NDArray
from sionna_scenes import WAVELENGTH_M, scene_of

from datafactory.paths import corner_echoes
from datafactory.paths.corner_aperture import (
    ACROSS,
    Cells,
    FaceOrder,
    Views,
    _from_foot,
    cells_along,
    ends_along,
    integrals,
    longer_along,
    pieces_in_sight,
)
from datafactory.paths.corner_edges import CornerEdges

CORNERS = [
    dihedral(20.0, 0.15, 0.2, 6.0),
    dihedral(12.0, (3.0, 0.4), 2.0, -20.0, middle_m=2.5),
    dihedral(6.0, (0.2, 5.0), 1.0, 25.0, 91.0, middle_m=-0.8, tilt_deg=4.0),
    dihedral(30.0, 8.0, 9.0),
]


@pytest.fixture
def seen_corners() -> tuple[CornerEdges, Views, Cells]:
    """Corners whose edges have the foot of the perpendicular and others, small, wide, unequal and off square."""
    faces = [item for n, faces in enumerate(CORNERS) for item in meshes_of(faces, cuts=2 + n)]
    facing, views = corner_echoes._facing(corners_seen(scene_of(*faces)), WAVELENGTH_M)
    corners = corners_seen(scene_of(*faces)).take(facing)
    assert len(corners) >= len(CORNERS)
    return corners, views, cells_along(corners, views, WAVELENGTH_M)


def test_the_sum_over_all_of_the_aperture_is_that_of_its_pieces(seen_corners) -> None:
    _, views, cells = seen_corners
    pieces = integrals(cells, views, WAVELENGTH_M, np.ones((2, len(cells.corner), ACROSS), dtype=bool))
    whole, along = np.zeros_like(pieces), cells.shares_along(WAVELENGTH_M)
    for order in (0, 1):
        one = FaceOrder.of(cells, views, order)
        ends = (one.share_to(b, WAVELENGTH_M) for b in (one.end(), np.zeros(len(along))))
        np.add.at(whole[order], cells.corner, along * np.subtract(*ends))
    np.testing.assert_allclose(whole, pieces, rtol=0.0, atol=1e-13)
    assert np.abs(pieces).max() > 0.1


def test_cells_of_a_strip_join(seen_corners) -> None:
    """Each begins where the last one ended, and all of a corner's have together the share between its two ends."""
    corners, views, cells = seen_corners
    joined = cells.corner[1:] == cells.corner[:-1]
    assert np.abs(cells.start[1:][joined] - cells.stop[:-1][joined]).max() < 1e-9
    nearest = np.clip(views.foot_z, *corners.extent()) - views.foot_z
    least = longer_along(nearest, views.height)
    assert (nearest == 0.0).any()
    assert (nearest != 0.0).any()
    total = np.zeros(len(corners), dtype=np.complex128)
    np.add.at(total, cells.corner, cells.shares_along(WAVELENGTH_M))
    low, high = (_from_foot(v, 0.25 * WAVELENGTH_M * v**2 - least) for v in ends_along(cells, len(corners)))
    np.testing.assert_allclose(total, high - low, rtol=0.0, atol=1e-12)


def test_a_leg_behind_a_hidden_one_is_not_looked_at_and_nothing_else_changes(seen_corners) -> None:
    """Against both legs of every piece of both orders."""
    corners, views, cells = seen_corners
    looked: list[NDArray[np.float64]] = []

    def recorded(sight: Sight) -> Sight:
        def look(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
            looked.append(end)
            return sight(start, end)

        return look

    def blinds(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.sin(40.0 * end[:, 2]) + np.sin(90.0 * end[:, 1]) > -0.4

    def open_sky(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.ones(len(end), dtype=bool)

    everything = pieces_in_sight(corners, cells, views, WAVELENGTH_M, recorded(open_sky))
    assert everything.all()
    legs, looked = looked, []
    fast = pieces_in_sight(corners, cells, views, WAVELENGTH_M, recorded(blinds))
    slow = [blinds(one, one) & blinds(other, other) for one, other in (legs[:2], legs[2:])]
    np.testing.assert_array_equal(fast, np.reshape(slow, fast.shape))
    assert 0.1 < fast.mean() < 0.6
    assert sum(map(len, looked)) < 0.9 * sum(map(len, legs))
