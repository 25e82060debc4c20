"""The shapes in the signatures of the synthesis are checked while tests run (``tests/conftest.py``)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.spread import columns, padded
from datafactory.synthesis.truth import truth_moments
from shared.radar import Radar

RadarMaker = Callable[..., Radar]


def one_path() -> ScatteredPaths:
    return ScatteredPaths.of_points(np.array([[5.0, 1.0, 0.0]]), np.zeros((1, 3)), np.ones(1))


def test_right_shapes_pass() -> None:
    assert columns(one_path(), np.array([0])).shape == (16, 1)
    assert padded(np.zeros((17, 3))).shape == (3, 32)


def test_wrong_shapes_and_types_do_not(small_radar: RadarMaker) -> None:
    with pytest.raises(TypeCheckError):
        padded(np.zeros((17, 2)))
    with pytest.raises(TypeCheckError):
        columns(one_path(), np.array([0.0]))
    with pytest.raises(TypeCheckError):
        truth_moments(PathTable(one_path()), small_radar(), np.zeros((64, 1), dtype=np.int64))
    with pytest.raises(TypeCheckError):
        truth_moments(PathTable(one_path()), small_radar(), np.zeros(64))
