"""Echoes that leave in one direction and come back from another, told from those that do not.

An echo off two walls, or off a wall and a thing, leaves in the direction u_t and arrives from u_r. With the places y_t
and y_r of each channel's TX and RX it is

    x_c = s exp(-j k (u_t y_t + u_r y_r))

to which no line of the virtual array is equal unless u_t = u_r: a fit takes several lines for it, at angles where
nothing stands. With the power that the best such echo explains of a cell, over that of the best line,

    G = max_(u_t, u_r) |sum_c conj(x_c(u_t, u_r)) x_c|^2 / max_u |sum_c conj(x_c(u, u)) x_c|^2

an echo of like ways has G = 1 but for noise. One echo of either kind in white noise is told from the other by this
ratio; of any number: Zheng, Long, Lops, Liu, Hu and Zhao, "Detection of ghost targets for automotive radar in the
presence of multipath", IEEE Trans. Signal Processing, 2024. Several lines in one cell have a larger G as well. G = 1
tells nothing of one TX or one RX, nor where TX that stand on a grid have the same phases in both directions.

The maximum over both angles is found in two steps: u_r where the TX together receive most, whatever their phases, then
u_t.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.physics.units import power_to_db
from trainer.estimators.array import POINTS_PER_CELL, LineArray, uniform_axis


def unlike_ways_db(values: NDArray[np.complexfloating], array: LineArray) -> NDArray[np.float64]:
    """[N] G of cells [N, C] in dB, 0 or more; wave fronts are taken as plane."""
    if array.elements is None:
        return np.zeros(len(values))
    (tx, of_tx), (rx, of_rx) = (np.unique(numbers, return_inverse=True) for numbers in array.elements)
    if min(len(tx), len(rx)) < 2 or not len(values):
        return np.zeros(len(values))
    # Places of TX and RX alone: their sums are known. What they have in common turns an echo by one phase.
    places = np.concatenate([np.eye(len(tx))[of_tx], np.eye(len(rx))[of_rx]], axis=1)
    along = np.linalg.lstsq(places, array.positions_m, rcond=None)[0]
    of_tx_alone, of_rx_alone = (LineArray(part, array.wavelength_m) for part in np.split(along, [len(tx)]))
    of_lines = np.abs(values @ _received(array)) ** 2
    arriving = _received(of_rx_alone)
    by_tx = np.stack([values[:, of_tx == t] @ arriving[of_rx[of_tx == t]] for t in range(len(tx))], axis=-1)
    strongest = np.argmax(np.sum(np.abs(by_tx) ** 2, axis=-1), axis=1)
    of_two_ways = np.abs(by_tx[np.arange(len(values)), strongest] @ _received(of_tx_alone)) ** 2
    line = np.maximum(of_lines.max(axis=1), np.finfo(np.float64).tiny)
    return np.asarray(power_to_db(np.maximum(of_two_ways.max(axis=1), line) / line))


def _received(array: LineArray) -> NDArray[np.complex128]:
    """[C, U] exp(j k u p): what adds up an echo from each of the angles that the elements tell apart."""
    received: NDArray[np.complex128] = array.manifold(uniform_axis(array, POINTS_PER_CELL)).conj()
    return received
