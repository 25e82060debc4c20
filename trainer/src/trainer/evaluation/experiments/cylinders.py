"""Vertical metal cylinders 5.7 m from the radar (the paper's Fig. 8 and 10), simulated, and images of what is near.

Each reflects from the point of its surface nearest to the radar. Its height, not published, is more than the first
Fresnel zone, sqrt(2 lambda R) = 0.21 m, and then its radar cross section no longer grows with its height: here it is a
point of 0 dBsm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal import target_amplitudes
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import close_up, in_plane, snapshot, truth_image
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.store import Values

RANGE_M = 5.7
RCS_DBSM = 0.0

Echoes = tuple[NDArray[np.float64], NDArray[np.complex128]]
"""([K, 3] positions [m], [K] amplitudes [sqrt(W)])."""


def cylinders(radar: Radar, u: NDArray[np.float64], phase: NDArray[np.float64]) -> Echoes:
    """The echoes of cylinders at u [K] with phases [K] [rad]."""
    positions = in_plane(np.full(len(u), RANGE_M), u)
    return positions, target_amplitudes(radar, positions, np.full(len(u), RCS_DBSM), phase)


def noisy_snapshot(radar: Radar, echoes: Echoes, seed: list[int]) -> NDArray[np.complex64]:
    """[R, C] range-channel matrix of the echoes with receiver noise [sqrt(W)]."""
    return snapshot(radar, *echoes, np.random.default_rng(seed))


def image_around(radar: Radar, contender: Contender, scene: Callable[[], NDArray[np.complex64]]) -> Values:
    """A contender's image of the range bins around the cylinders, ``image`` [rows, U]."""
    rows, _ = close_up(radar, RANGE_M)
    return {"image": contender.answer.image_rows(scene(), cell_noise_power(radar), rows).astype(np.float32)}


def truth_around(radar: Radar, echoes: Echoes) -> Values:
    """What the virtual sensor sees there, ``image`` [rows, U]."""
    rows, _ = close_up(radar, RANGE_M)
    return {"image": truth_image(radar, *echoes)[rows]}
