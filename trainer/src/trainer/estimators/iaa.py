"""The iterative adaptive approach, IAA-APES, for one snapshot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray, NoisePower, image_rows, scan_axis
from trainer.estimators.covariance import FLOOR, Distances, loaded_inverse

ITERATIONS = 15
"""Yardibi et al. report convergence within some 10 to 15."""


class IterativeAdaptive:
    """s(u) = a^H R^-1 x / a^H R^-1 a,   R = sum_n |s(u_n)|^2 a_n a_n^H, repeated from delay-and-sum on.

    Yardibi, Li, Stoica, Xue and Baggeroer, "Source localization and sensing: a nonparametric iterative adaptive
    approach based on weighted least squares", IEEE Trans. Aerosp. Electron. Syst. 46(1), 2010. The sum runs
    over the whole period of u, not only over the angles shown: what comes from beyond them would otherwise be
    explained by wrong ones. No model order, no noise power, but a floor 60 dB below the power in the row;
    amplitudes are nearly unbiased. Two targets closer than about half a cell merge.

    :param iterations: after the first, which is delay-and-sum
    """

    name = "iaa"

    def __init__(self, iterations: int = ITERATIONS) -> None:
        self.iterations = iterations

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] at the angles u [U]; the noise power is not used."""
        scan, shown = scan_axis(array, u)
        conjugate = array.manifold(scan).conj()  # (C, N)
        distances = Distances(array, scan)

        def solve(x: NDArray[np.complex128], _: NDArray[np.float64]) -> NDArray[np.float64]:
            return adaptive_amplitudes(x, conjugate, distances, self.iterations)[:, shown]

        return image_rows(snapshots, array, len(u), noise_power, solve)


def adaptive_amplitudes(
    x: NDArray[np.complex128], conjugate: NDArray[np.complex128], distances: Distances, iterations: int
) -> NDArray[np.float64]:
    """[B, N] |s(u)| of snapshots x [B, C] at the angles of ``conjugate`` [C, N], the manifold's conjugate."""
    amplitude = np.abs(x @ conjugate) / x.shape[1]
    for _ in range(iterations):
        covariance = distances.covariance(amplitude**2)
        total = covariance[:, 0, 0].real
        inverse = loaded_inverse(covariance, FLOOR * total)
        numerator = np.abs(np.einsum("bcd,bd->bc", inverse, x) @ conjugate)
        # a^H R^-1 a is at least C / trace(R): what is less is rounding.
        least = 1.0 / ((1.0 + FLOOR) * total[:, None])
        amplitude = numerator / np.maximum(distances.quadratic_form(inverse), least)
    return amplitude
