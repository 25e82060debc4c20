"""A table that stands still: delays of its moment, for ever."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mirrored, scattered_delays, specular_delays
from path_tables import a_table

from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths


@pytest.mark.parametrize("time_s", [0.0, 5.2e-3, -1.0])
def test_a_table_at_rest_keeps_the_delays_of_its_moment(generator, time_s: float) -> None:
    table = a_table(generator)
    still = table.at_rest(time_s)
    assert table.moves()
    assert not still.moves()
    tx, rx = np.array([0.0, -0.048, 0.0]), np.array([0.0, 0.045, 0.0])
    for later_s in (0.0, 0.3):
        scattered = (
            scattered_delays(part, tx, rx, at) for part, at in ((still.scattered, later_s), (table.scattered, time_s))
        )
        specular = (
            specular_delays(part, tx, rx, at) for part, at in ((still.specular, later_s), (table.specular, time_s))
        )
        for got, expected in (scattered, specular):
            np.testing.assert_allclose(np.asarray(got), np.asarray(expected), rtol=1e-12)
    np.testing.assert_array_equal(still.scattered.amplitude, table.scattered.amplitude)
    np.testing.assert_array_equal(still.specular.amplitude, table.specular.amplitude)


def test_a_moving_mirror_at_rest_shows_the_image_of_its_moment() -> None:
    """A mirror at x = 10 m that recedes with 4 m/s stands at 12 m after half a second."""
    normal = np.array([1.0, 0.0, 0.0])
    specular = SpecularPaths(
        image=mirrored(np.zeros(3), (10.0 * normal, normal))[None],
        image_velocity=np.array([[8.0, 0.0, 0.0]]),
        axes=(np.eye(3) - 2.0 * np.outer(normal, normal))[None],
        amplitude=np.ones(1, dtype=complex),
        depth=np.ones(1, dtype=np.int8),
        object_index=np.zeros(1, dtype=np.int32),
        kinds=np.ones(1, dtype=np.uint8),
    )
    still = PathTable(ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)), specular).at_rest(0.5)
    np.testing.assert_allclose(still.specular.image, mirrored(np.zeros(3), (12.0 * normal, normal))[None], atol=1e-12)
