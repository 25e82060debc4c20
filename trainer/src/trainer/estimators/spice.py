"""Sparse covariance fitting: SPICE, an l1 method, and LIKES, its likelihood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray, NoisePower, image_rows, scan_axis
from trainer.estimators.covariance import FLOOR, Distances, loaded_inverse

SPICE_ITERATIONS, LIKES_ITERATIONS = 60, 12
"""LIKES resolves as many pairs with these as with 30 steps of its paper; SPICE, of first order, converges slowly."""


class SparseCovariance:
    """Powers P_n >= 0 of a model R = sum_n P_n a_n a_n^H + sigma^2 I of the snapshot; the image is |P_n a_n^H R^-1 x|.

    Multiplicative updates from delay-and-sum on:

        SPICE   P_n <- P_n |a_n^H R^-1 x| |x| / sqrt(C)                   min x^H R^-1 x + sum_n P_n C / |x|^2
        LIKES   P_n <- P_n |a_n^H R^-1 x|^2 / (a_n^H R^-1 a_n)            min x^H R^-1 x + ln det R

    Stoica, Babu and Li, "SPICE: a sparse covariance-based estimation method for array processing", IEEE Trans. Signal
    Process. 59(2), 2011; Stoica and Babu, "SPICE and LIKES: two hyperparameter-free methods for sparse-parameter
    estimation", Signal Process. 92, 2012. LIKES takes the square of its paper's step, with the same fixed points
    (:mod:`shared.signal.adaptive`). For one snapshot SPICE is a square-root LASSO (Rojas, Katselis and
    Hjalmarsson 2013) and shrinks amplitudes; LIKES is the maximum likelihood of random amplitudes, and needs no
    number of targets. The noise power is the receiver's, known here; the angles cover the whole period of u. The
    image holds amplitudes expected from R: those of noise shrink to next to nothing.

    :param reweighted: LIKES; SPICE otherwise
    """

    def __init__(self, reweighted: bool = False) -> None:
        self.reweighted = reweighted
        self.name = "likes" if reweighted else "spice"
        self.iterations = LIKES_ITERATIONS if reweighted else SPICE_ITERATIONS

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] with noise of ``noise_power`` [W] at the angles u [U]."""
        scan, shown = scan_axis(array, u)
        conjugate = array.manifold(scan).conj()  # (C, N)
        distances = Distances(array, scan)

        def solve(x: NDArray[np.complex128], noise: NDArray[np.float64]) -> NDArray[np.float64]:
            energy = np.sum(np.abs(x) ** 2, axis=1)
            noise = np.maximum(noise, FLOOR * energy / array.channels)
            weight = np.sqrt(energy / array.channels)[:, None]
            power = (np.abs(x @ conjugate) / array.channels) ** 2
            filtered = np.zeros_like(power)
            for _ in range(self.iterations):
                covariance = distances.covariance(power)
                inverse = loaded_inverse(covariance, noise)
                filtered = np.abs(np.einsum("bcd,bd->bc", inverse, x) @ conjugate)
                if self.reweighted:
                    # a^H R^-1 a is at least C / trace(R): what is less is rounding.
                    least = 1.0 / (covariance[:, 0, 0].real + noise)
                    weight = filtered / np.maximum(distances.quadratic_form(inverse), least[:, None])
                estimate, power = power * filtered, power * filtered * weight
            return estimate[:, shown]

        return image_rows(snapshots, array, len(u), noise_power, solve)
