"""GOSPA against its definition, the least over all assignments."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.metrics.gospa import gospa


def slow_gospa(estimated: NDArray, true: NDArray, cutoff: float, exponent: float) -> float:
    """The definition: the least over all partial assignments."""
    best = np.inf
    places = [*range(len(true)), *[-1] * len(estimated)]
    for chosen in set(permutations(places, len(estimated))):
        pairs = [(i, j) for i, j in enumerate(chosen) if j >= 0]
        left = len(estimated) + len(true) - 2 * len(pairs)
        cost = sum(np.linalg.norm(estimated[i] - true[j]) ** exponent for i, j in pairs) + cutoff**exponent / 2 * left
        best = min(best, cost)
    return float(best ** (1 / exponent))


POINTS = st.integers(0, 4).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.floats(-3, 3, width=16)))


@given(POINTS, POINTS, st.sampled_from([0.5, 2.0, 10.0]), st.sampled_from([1.0, 2.0]))
def test_gospa_is_its_definition(estimated: NDArray, true: NDArray, cutoff: float, exponent: float) -> None:
    found = gospa(estimated, true, cutoff, exponent)
    assert found.distance == pytest.approx(slow_gospa(estimated, true, cutoff, exponent), abs=1e-9)
    assert found.localisation + found.missed + found.false == pytest.approx(found.distance**exponent, abs=1e-9)
    assert gospa(true, estimated, cutoff, exponent).distance == pytest.approx(found.distance)


def test_gospa_parts() -> None:
    points = np.array([[0.0, 0.0], [5.0, 0.0]])
    assert gospa(points, points, 2.0).distance == 0.0
    empty = gospa(points[:0], points, 2.0)
    assert (empty.missed, empty.false, empty.localisation) == (4.0, 0.0, 0.0)
    extra = gospa(points, points[:0], 2.0)
    assert (extra.missed, extra.false) == (0.0, 4.0)
    near = gospa(points + 0.5, points[:1], 2.0)
    assert (near.assigned, near.localisation, near.false) == (1, pytest.approx(0.5), 2.0)
    assert gospa(points * 1e20, points * 0.0, 1e20).distance == pytest.approx(
        gospa(points, points * 0.0, 1.0).distance * 1e20
    )
    # Random clutter far from the truth: c^2 / 2 for each point.
    assert gospa(points + 100.0, points, 2.0).distance == pytest.approx(np.sqrt(4 * 2.0**2 / 2))


@pytest.mark.parametrize(
    ("estimated", "true", "cutoff", "exponent"),
    [
        (np.zeros((1, 2)), np.zeros((1, 3)), 1.0, 2.0), (np.zeros(2), np.zeros((1, 2)), 1.0, 2.0),
        (np.zeros((1, 2)), np.zeros((1, 2)), 0.0, 2.0), (np.zeros((1, 2)), np.zeros((1, 2)), 1.0, 0.5),
        (np.full((1, 2), np.nan), np.zeros((1, 2)), 1.0, 2.0),
    ],
)  # fmt: skip
def test_gospa_refuses_what_has_no_distance(estimated: NDArray, true: NDArray, cutoff: float, exponent: float) -> None:
    with pytest.raises(InputError, match="gospa"):
        gospa(estimated, true, cutoff, exponent)
