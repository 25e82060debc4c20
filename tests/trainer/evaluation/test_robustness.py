"""Impairments of the sensor."""

import numpy as np
import pytest

from shared.radar import load_radar
from trainer.data.arrays import ArrayChoice
from trainer.evaluation.experiments.robustness import Impairment, channel_factors, displaced


def test_impairments_do_what_they_say():
    generator = np.random.default_rng(2)
    array = load_radar("avr-qdm-110").array
    sparse = ArrayChoice(name="sparse4", rx=(0, 1, 10, 15))
    assert np.all(channel_factors(Impairment("SNR", 20.0), array, sparse, generator) == 1.0)
    dead = channel_factors(Impairment("dead RX", 2.0), array, sparse, generator)
    assert np.count_nonzero(dead == 0) == 2 * 3
    assert set(array.channel_rx[dead == 0]) < set(sparse.rx)
    phases = np.stack([channel_factors(Impairment("phase error", 10.0), array, sparse, generator) for _ in range(50)])
    assert np.allclose(np.abs(phases), 1.0)
    assert np.rad2deg(np.angle(phases)).std() == pytest.approx(10.0, rel=0.07)
    gains = np.stack([channel_factors(Impairment("gain error", 2.0), array, sparse, generator) for _ in range(50)])
    assert (20.0 * np.log10(np.abs(gains))).std() == pytest.approx(2.0, rel=0.07)
    moved = displaced(array, 0.5, generator)
    difference = moved.rx - array.rx
    assert not difference[:, [0, 2]].any()
    assert 0.2e-3 < difference[:, 1].std() < 0.9e-3
    assert displaced(array, 0.0, generator) == array
