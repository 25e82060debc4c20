"""Covariances of scanned powers and their quadratic forms, by the distances between elements.

The covariance of uncorrelated sources of power P_n at u_n on a line depends on the distance alone,

    R_cd = r(p_c - p_d),   r(l) = sum_n P_n exp(-j k u_n l),   r(-l) = r(l)*

and so does the form that the Capon family divides by, for a Hermitian matrix M:

    a(u)^H M a(u) = sum_(l >= 0) w_l Re[ m_l exp(j k u l) ],   m_l = sum_(p_c - p_d = l) M_cd,   w_0 = 1, else 2.

48 elements on a grid have 48 distances and 2304 pairs: that is the work saved. Any other line works, with more of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray

DISTANCE_DIGITS = 8
"""Distances that agree to this many decimals of a wavelength are one, that of the first such pair."""
FLOOR = 1e-6
"""Least power of white noise in a covariance, of the power in a channel. The form a^H R^-1 a is wrong by some
(power / noise)^2 x 2e-16 where R was inverted as a whole: 1e-3 with this floor, everything with 1e-9."""


class Distances:
    """The distances of an array's element pairs, and their phases at N angles.

    :param u: [N] angles
    """

    def __init__(self, array: LineArray, u: NDArray[np.float64]) -> None:
        positions = array.positions_m / array.wavelength_m
        difference = positions[:, None] - positions[None, :]
        rounded = np.round(difference, DISTANCE_DIGITS)
        _, first, index = np.unique(np.abs(rounded), return_index=True, return_inverse=True)
        distance = np.abs(difference).ravel()[first]
        self._index = index.reshape(difference.shape)
        self._forward = rounded >= 0.0
        # Pairs with p_c >= p_d; those of one distance stand side by side, so that reduceat sums them.
        pairs = np.flatnonzero(self._forward)
        by_distance = np.argsort(self._index.ravel()[pairs], kind="stable")
        self._pairs = pairs[by_distance]
        self._starts = np.searchsorted(self._index.ravel()[self._pairs], np.arange(len(distance)))
        # Of two elements at one place both pairs have p_c >= p_d.
        self._weight = np.where(np.abs(rounded).ravel()[first] > 0.0, 2.0, 1.0)
        phase = 2.0 * np.pi * np.outer(distance, u)
        self._cosine, self._sine = np.cos(phase), np.sin(phase)  # (L, N)

    def covariance(self, power: NDArray[np.float64]) -> NDArray[np.complex128]:
        """[B, C, C] covariances of powers [B, N] at the N angles."""
        by_distance = power @ self._cosine.T - 1j * (power @ self._sine.T)
        full = by_distance[:, self._index]
        return np.where(self._forward, full, full.conj())

    def quadratic_form(self, matrix: NDArray[np.complex128]) -> NDArray[np.float64]:
        """[B, N] a(u_n)^H M a(u_n) of Hermitian matrices M [B, C, C]."""
        flat = matrix.reshape(len(matrix), -1)[:, self._pairs]
        sums = np.add.reduceat(flat, self._starts, axis=1) * self._weight
        return sums.real @ self._cosine - sums.imag @ self._sine


def loaded_inverse(covariance: NDArray[np.complex128], loading: NDArray[np.float64]) -> NDArray[np.complex128]:
    """[B, C, C] inverses of covariances plus ``loading`` [B] on their diagonals."""
    channels = covariance.shape[-1]
    diagonal = np.arange(channels)
    loaded = covariance.copy()
    loaded[:, diagonal, diagonal] += loading[:, None]
    return np.asarray(np.linalg.inv(loaded), dtype=np.complex128)
