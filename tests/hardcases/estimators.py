"""Hard cases of the direction estimators: noise alone, and a target that is 200 dB above another.

Every estimator of ``trainer.estimators`` is asked; the worst of them is the measurement.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from hardcases.case import HardCase
from numpy.typing import NDArray

from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS, Estimator, line_array

U = np.linspace(-0.85, 0.85, 171)
NOISE_W = 1e-4


def _arrays() -> dict[str, LineArray]:
    """The paper's arrays of 48, 18 and 12 virtual elements."""
    radar = Radar()
    return {name: line_array(radar, radar.array.channel_indices(rx)) for name, rx in AVR_QDM_110_THINNED_RX.items()}


SPARSE, FULL = _arrays()["sparse4"], _arrays()["full"]


def _asked(array: LineArray) -> Iterator[Estimator]:
    """Every estimator that takes this array, new."""
    makers = [*ESTIMATORS.values(), *(UNIFORM_ESTIMATORS.values() if array is FULL else ())]
    return (make() for make in makers)


def _noise(rows: int, channels: int) -> NDArray[np.complex128]:
    """[rows, channels] circular noise of NOISE_W."""
    generator = np.random.default_rng(11)
    return np.sqrt(NOISE_W / 2.0) * (generator.standard_normal((rows, channels, 2)) @ np.array([1.0, 1j]))


def _targets(array: LineArray, u: NDArray[np.float64]) -> NDArray[np.complex128]:
    """[C] snapshot of equal targets of unit amplitude and random phase, free of noise."""
    return array.manifold(u) @ np.exp(2j * np.pi * np.random.default_rng(12).uniform(size=len(u)))


def _not_finite(snapshots: NDArray, array: LineArray, noise_power: float) -> float:
    """Values of any estimator's image that are not finite, or below zero."""
    images = (estimator.image(snapshots, array, U, noise_power) for estimator in _asked(array))
    return float(sum(np.count_nonzero(~(np.isfinite(image) & (image >= 0.0))) for image in images))


def _noise_alone() -> float:
    """Largest magnitude that an estimator draws in noise alone, over the noise's own in one channel.

    Maximum likelihood is told of two targets that are not there, whose best angles may all but coincide.
    """
    rows = 40
    worst = 0.0
    for array in (SPARSE, FULL):
        snapshots = _noise(rows, array.channels)
        if _not_finite(snapshots, array, NOISE_W):
            return np.inf
        images = (estimator.image(snapshots, array, U, NOISE_W) for estimator in _asked(array))
        worst = max(worst, *(float(image.max()) for image in images))
    return worst / float(np.sqrt(NOISE_W))


def _strong_beside_weak() -> float:
    """Values not finite where one target is 200 dB above another, and above the noise."""
    snapshot = _targets(SPARSE, np.array([0.1])) + 1e-10 * _targets(SPARSE, np.array([-0.5]))
    return _not_finite(snapshot[None], SPARSE, 0.0) + _not_finite(snapshot[None], SPARSE, 1e-20)


CASES = (
    HardCase("estimators on noise alone", "sparse solvers blow noise up", 3.0, "times the noise", _noise_alone),
    HardCase("200 dB between targets", "a covariance of condition 1e40", 0.0, "not finite", _strong_beside_weak),
)
