"""What an estimator is, and all of them by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.adaptive import IterativeAdaptive, SparseCovariance, VirtualView
from trainer.estimators.array import LineArray, NoisePower
from trainer.estimators.baselines import DelayAndSum, Music
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.omp import OrthogonalMatchingPursuit


class Estimator(Protocol):
    """An angular spectrum from one snapshot for each range bin."""

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitudes [sqrt(W)], always finite; a row of zeros where the snapshot is zero.

        :param snapshots: [R, C] complex, the channels of ``array`` in its order [sqrt(W)]
        :param u: [U] angles sin(azimuth), rising
        :param noise_power: of one channel in one range-Doppler cell [W], of all range bins or [R] of each; 0 where
            there is none. Of measured rows it includes what the model leaves out, see
            :func:`shared.signal.model_error.row_noise`.
        :raises InputError: snapshots of another shape or not finite, a negative noise power
        """
        ...


ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "das": DelayAndSum,
    "das-hamming": lambda: DelayAndSum("hamming"),
    "das-hann": lambda: DelayAndSum("hann"),
    "music": Music,
    "iaa": IterativeAdaptive,
    "iaa-view": VirtualView,
    "likes-view": lambda: VirtualView(sharp=True),
    "likes-view-ego": lambda: VirtualView(sharp=True, told=True),
    "omp": OrthogonalMatchingPursuit,
    "omp-cfar": lambda: OrthogonalMatchingPursuit("cfar"),
    "spice": SparseCovariance,
    "likes": lambda: SparseCovariance(reweighted=True),
    "ml": MaximumLikelihood,
}
"""A new estimator by the name that ``--methods`` takes; all of them work on any array."""

UNIFORM_ESTIMATORS: dict[str, Callable[[], Estimator]] = {"music-fbss": lambda: Music("forward-backward")}
"""Those that need a uniform line of elements, and refuse any other with an ``InputError``."""
