"""How far the power in a cell is from its average: the scatter of the reference is taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datafactory.accuracy.knobs import DEFAULT, Effort
from datafactory.accuracy.power import Realisations, compared, mean_and_variance, paired_error, power_error

CELLS = (96, 20)


def test_the_scatter_of_a_frame_does_not_contain_that_of_its_reference(generator) -> None:
    """One cell of Gamma power of shape k = 50: its amplitude scatters by sqrt(1 / 4 k), known whatever the reference
    is."""
    many = Realisations(generator.gamma(50.0, 1.0 / 50.0, (4000, 1, 1)), 0.0)
    squares, biased = [], []
    for _ in range(200):
        mean, variance = mean_and_variance(generator.gamma(50.0, 1.0 / 50.0, (3, 1, 1)))
        difference = (np.sqrt(many.power) - np.sqrt(mean)) ** 2
        squares.append(float((difference - variance).mean()))
        biased.append(float(difference.mean()))
    assert np.mean(squares) == pytest.approx(1.0 / 200.0, rel=0.1)
    assert np.mean(biased) == pytest.approx(4.0 / 3.0 / 200.0, rel=0.1)
    assert not mean_and_variance(many.power[:1])[1].any()


def test_cells_are_compared_as_stated() -> None:
    reference = np.ones(CELLS)
    reference[20, 1] = 4.0
    value = reference.copy()
    value[10, 0] = 4.0
    error = compared(Realisations(value[None], 7.0), reference, np.zeros(1))
    assert error.peak == pytest.approx(0.5)
    assert error.total == pytest.approx((reference.sum() + 3.0) / reference.sum())
    assert error.paths == 7.0
    # What the reference's own scatter explains is no error.
    assert compared(Realisations(value[None], 7.0), reference, np.ones(1)).peak == 0.0
    nothing = compared(Realisations(0.0 * value[None], 0.0), 0.0 * reference, np.zeros(1))
    assert (nothing.peak, nothing.total) == (0.0, 1.0)


def test_draws_are_independent_and_repeatable(samples) -> None:
    knobs, effort, (sample,) = replace(DEFAULT, rays=1000), Effort(4000, 2, 2), samples
    against = replace(knobs, rays=4000)
    errors = [power_error(sample, knobs, sample, against, effort, {}, draw) for draw in (0, 0, 1)]
    assert errors[0] == errors[1] != errors[2]
    paired = paired_error(sample, knobs, knobs, effort, {})
    assert (paired.peak, paired.total) == (0.0, 1.0)


def test_few_rays_have_more_realisations() -> None:
    effort = Effort(800_000)
    assert [effort.count(rays) for rays in (800_000, 100_000, 50_000, 1)] == [4, 8, 16, 16]
