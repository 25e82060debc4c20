"""What counts as two targets found."""

from __future__ import annotations

import numpy as np
import pytest
from paper_arrays import U

from shared.physics.errors import InputError
from trainer.metrics.resolution import (
    resolved,
    strongest_peaks,
)


def test_random_angles_resolve_as_often_as_chance_says() -> None:
    separation = 0.4
    trials = 4000
    true = np.tile([[-separation / 2, separation / 2]], (trials, 1))
    found = np.sort(np.random.default_rng(0).uniform(-1.0, 1.0, (trials, 2)), axis=1)
    # Each angle must fall in its half of an interval of twice the separation: 2 (s / 2)^2.
    expected = 2.0 * (separation / 2.0) ** 2
    assert np.mean(resolved(found, true)) == pytest.approx(expected, abs=4.0 * np.sqrt(expected / trials))


def test_resolved_refuses_other_shapes() -> None:
    with pytest.raises(InputError, match="shapes"):
        resolved(np.zeros((3, 2)), np.zeros((3, 3)))


def test_perfect_angles_resolve_and_an_empty_image_does_not() -> None:
    true = np.array([[-0.1, 0.1], [0.2, 0.25], [-0.5, -0.4]])
    assert resolved(true, true).all()
    assert not resolved(strongest_peaks(np.zeros((3, len(U))), U, 2), true).any()
    one = np.column_stack([true[:, 0], np.full(3, np.nan)])
    assert not resolved(one, true).any()
    # A single peak in the middle is not two.
    assert not resolved(np.repeat(true.mean(axis=1, keepdims=True), 2, axis=1), true).any()
