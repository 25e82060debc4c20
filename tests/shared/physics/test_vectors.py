"""Vectors in space, against NumPy's own."""

from __future__ import annotations

import numpy as np
import pytest

from shared.physics.vectors import dots, lengths, taken

GENERATOR = np.random.default_rng(5)
VECTORS, OTHERS = GENERATOR.normal(size=(2, 1000, 3)) * 10.0 ** GENERATOR.integers(-8, 8, (2, 1000, 1))


@pytest.mark.parametrize("shape", [(1000, 3), (10, 100, 3), (0, 3), (3,)])
def test_lengths_are_numpys_to_the_last_bit(shape):
    vectors = VECTORS.reshape(-1)[: int(np.prod(shape))].reshape(shape)
    np.testing.assert_array_equal(lengths(vectors), np.linalg.norm(vectors, axis=-1))


def test_vectors_need_not_stand_together_in_memory():
    np.testing.assert_array_equal(lengths(VECTORS[::3]), np.linalg.norm(VECTORS[::3], axis=1))
    np.testing.assert_array_equal(lengths(VECTORS.T[:, :3]), np.linalg.norm(VECTORS.T[:, :3], axis=1))


def test_dots_are_numpys_to_rounding():
    bound = 4.0 * np.finfo(float).eps * (np.abs(VECTORS) * np.abs(OTHERS)).sum(axis=1)
    assert (np.abs(dots(VECTORS, OTHERS) - np.einsum("ki,ki->k", VECTORS, OTHERS)) <= bound).all()


@pytest.mark.parametrize("index", [np.array([4, 4, 0, -1]), np.zeros(0, dtype=np.int64), VECTORS[:, 0] > 0.0])
@pytest.mark.parametrize("array", [VECTORS, VECTORS[:, 0], VECTORS.reshape(1000, 3, 1)])
def test_rows_are_those_of_indexing(array, index):
    np.testing.assert_array_equal(taken(array, index), array[index])
