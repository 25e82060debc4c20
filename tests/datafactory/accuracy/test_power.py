"""How far the power in a cell is from its average: the scatter of the reference is taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sampled_frames import EFFECTS

from datafactory.accuracy.knobs import (
    DEFAULT,
)
from datafactory.accuracy.power import Effort, compared, mean_and_variance, power_error
from shared.radar import Radar


def exponential_cells(generator: np.random.Generator, radar: Radar, count: int) -> np.ndarray:
    """[count, R, 20] realisations whose mean is 1 in the first ten columns and 4 in the others."""
    mean = np.repeat([1.0, 4.0], 10)
    return generator.gamma(50.0, mean / 50.0, (count, radar.waveform.range_bins, 20))


def test_the_scatter_of_a_frame_does_not_contain_that_of_its_reference(generator, radar):
    """The amplitude of a Gamma power of shape k scatters by sqrt(mean / 4 k): known, whatever the reference is."""
    value = exponential_cells(generator, radar, 8)
    expected = np.sqrt(1.0 / (4.0 * 50.0))
    for count in (3, 100):
        reference, variance = mean_and_variance(exponential_cells(generator, radar, count))
        assert compared(value, reference, variance, radar).l2 == pytest.approx(expected, rel=0.03)
    reference, variance = mean_and_variance(exponential_cells(generator, radar, 3))
    biased = compared(value, reference, np.zeros(1), radar).l2
    assert biased == pytest.approx(expected * np.sqrt(4.0 / 3.0), rel=0.03)


def test_cells_are_compared_as_stated(radar):
    reference = np.ones((radar.waveform.range_bins, 3))
    reference[20, 1] = 4.0
    value = reference.copy()
    value[10, 0] = 4.0
    error = compared(value[None], reference, np.zeros(1), radar)
    total, weight = reference.sum(), radar.waveform.ranges_m**4
    assert error.peak == pytest.approx(0.5)
    assert error.l2 == pytest.approx(np.sqrt(1.0 / total))
    assert error.l1 == pytest.approx(3.0 / total)
    assert error.l1_range_weighted == pytest.approx(3.0 * weight[10] / (weight @ reference.sum(axis=1)))
    assert error.total == pytest.approx((total + 3.0) / total)
    nothing = compared(0.0 * value[None], 0.0 * reference, np.zeros(1), radar)
    assert (nothing.peak, nothing.l1, nothing.total) == (0.0, 0.0, 1.0)


def test_draws_are_independent_and_repeatable(samples, radar):
    settings = replace(DEFAULT, rays=1000, effects=EFFECTS)
    against, effort = replace(settings, rays=4000), Effort(4000, realisations=2, reference_realisations=2)
    errors = [power_error(samples[0], settings, against, effort, radar, {}, draw=draw) for draw in (0, 0, 1)]
    assert errors[0] == errors[1] != errors[2]
    paired = power_error(samples[0], settings, settings, effort, radar, {}, paired=True)
    assert (paired.peak, paired.l1, paired.total) == (0.0, 0.0, 1.0)
