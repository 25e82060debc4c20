"""What a long line would see of the echoes that the iterative adaptive approach finds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.signal.steering import manifold
from shared.signal.windows import angle_window
from trainer.estimators.array import LineArray, NoisePower, image_rows, scan_axis
from trainer.estimators.covariance import FLOOR, Distances, loaded_inverse
from trainer.estimators.iaa import adaptive_amplitudes

ITERATIONS = 5
"""More make the powers sparser, and the view of extended targets with them."""
ELEMENTS, WINDOW = 256, "taylor-30"
"""Of the line: the virtual sensor of the paper and the datasets' default truth."""


class VirtualView:
    """|sum_n h(u - u_n) P_n a_n^H R^-1 x|,   R = sum_n P_n a_n a_n^H + sigma^2 I,   P_n = |s(u_n)|^2 of IAA.

    P_n a_n^H R^-1 x is the mean of an echo from u_n of power P_n, given the snapshot: the echoes add with their phases
    as they would on the line, whose windowed response is h. A spectrum's peak is as wide as the array leaves it; a
    truth image has the line's width, and its sum of several echoes. No training: how far the physics goes alone.

    The line has half a wavelength between its elements and stands in the middle of the radar frame.
    """

    name = "iaa-view"

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] with noise of ``noise_power`` [W] at the angles u [U]."""
        scan, _ = scan_axis(array, u)
        conjugate = array.manifold(scan).conj()  # (C, N)
        distances = Distances(array, scan)
        places = 0.5 * array.wavelength_m * (np.arange(ELEMENTS) - 0.5 * (ELEMENTS - 1))
        weights = angle_window(WINDOW, ELEMENTS)[:, None] / ELEMENTS
        seen = manifold(places, array.wavelength_m, scan).T
        line = seen @ (weights * manifold(places, array.wavelength_m, np.asarray(u)).conj())  # (N, U)

        def solve(x: NDArray[np.complex128], noise: NDArray[np.float64]) -> NDArray[np.float64]:
            power = adaptive_amplitudes(x, conjugate, distances, ITERATIONS) ** 2
            covariance = distances.covariance(power)
            inverse = loaded_inverse(covariance, np.maximum(noise, FLOOR * covariance[:, 0, 0].real))
            echo = power * (np.einsum("bcd,bd->bc", inverse, x) @ conjugate)
            return np.asarray(np.abs(echo @ line))

        return image_rows(snapshots, array, len(u), noise_power, solve)
