"""False alarms of noise alone against the rate of upcrossings."""

from __future__ import annotations

import numpy as np
import pytest
from paper_arrays import ARRAYS, U, noise

from shared.physics.errors import InputError
from trainer.estimators.base import ESTIMATORS
from trainer.metrics.noise_only import false_alarms, noise_level


def test_false_alarms_of_delay_and_sum_are_those_of_rice() -> None:
    array, rows, probability = ARRAYS["full"], 6000, 1e-3
    image = ESTIMATORS["das"]().image(noise(array, rows, 2.0, np.random.default_rng(1)), array, U, 2.0)
    level = noise_level(array, 2.0, probability)
    assert np.mean(image > level) == pytest.approx(probability, rel=0.15)
    beta = 2.0 * np.pi / array.wavelength_m * np.std(array.positions_m)
    expected = np.sqrt(-np.log(probability)) * beta * 1.7 / np.sqrt(np.pi) * probability
    assert false_alarms(image, level) / rows == pytest.approx(expected, rel=0.15)
    assert false_alarms(np.zeros((3, 50)), level) == 0
    with pytest.raises(InputError, match="probability"):
        noise_level(array, 2.0, 0.0)
