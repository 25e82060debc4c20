"""Hard cases of the direction estimators: no noise, noise alone, and a target that is 200 dB above another.

Every estimator of ``trainer.estimators`` is asked; the worst of them is the measurement.
"""

import numpy as np
from hardcases.case import HardCase
from numpy.typing import NDArray

from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from trainer.estimators.array import LineArray, line_array
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS

U = np.linspace(-0.85, 0.85, 171)
NOISE_W = 1e-4


SPARSE, FULL = (
    line_array(Radar(), Radar().array.channel_indices(AVR_QDM_110_THINNED_RX[name])) for name in ("sparse4", "full")
)
"""The paper's arrays of 12 and 48 virtual elements."""


def _images(snapshots: NDArray, array: LineArray, noise_power: float) -> list[NDArray]:
    """Those of every estimator that takes this array."""
    makers = [*ESTIMATORS.values(), *(UNIFORM_ESTIMATORS.values() if array is FULL else ())]
    return [make().image(snapshots, array, U, noise_power) for make in makers]


def _not_finite(images: list[NDArray]) -> float:
    """Values that are not finite, or below zero."""
    return float(sum(np.count_nonzero(~(np.isfinite(image) & (image >= 0.0))) for image in images))


def _rank_one() -> float:
    """Grid steps between lone targets free of noise and the peaks that an estimator draws; AIC meets exact zeros."""
    columns = np.array([20, 85, 140])
    images = (image for array in (SPARSE, FULL) for image in _images(array.manifold(U[columns]).T, array, 0.0))
    return float(max(np.abs(image.argmax(axis=1) - columns).max() for image in images))


def _noise_alone() -> float:
    """Largest magnitude that an estimator draws in noise alone, over the noise's own in one channel.

    Maximum likelihood is told of two targets that are not there, whose best angles may all but coincide.
    """
    worst = 0.0
    for array in (SPARSE, FULL):
        circular = np.random.default_rng(11).standard_normal((40, array.channels, 2)) @ np.array([1.0, 1j])
        images = _images(np.sqrt(NOISE_W / 2.0) * circular, array, NOISE_W)
        if _not_finite(images):
            return np.inf
        worst = max(worst, *(float(image.max()) for image in images))
    return worst / float(np.sqrt(NOISE_W))


def _strong_beside_weak() -> float:
    """Values not finite where one target is 200 dB above another, and above the noise."""
    snapshot = SPARSE.manifold(np.array([0.1, -0.5])) @ np.array([1.0, 1e-10j])
    return sum(_not_finite(_images(snapshot[None], SPARSE, noise_w)) for noise_w in (0.0, 1e-20))


CASES = (
    HardCase("estimators, rank one, no noise", "AIC's logarithm of zero eigenvalues", 1.0, "grid steps", _rank_one),
    HardCase("estimators on noise alone", "sparse solvers blow noise up", 3.0, "times the noise", _noise_alone),
    HardCase("200 dB between targets", "a covariance of condition 1e40", 0.0, "not finite", _strong_beside_weak),
)
