"""Delay-and-sum: the matched filter, with a window over the aperture."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray, NoisePower, image_rows

WINDOWS = {"none": 1.0, "hamming": 0.54, "hann": 0.5}
"""Constant part alpha of the raised cosine alpha + (1 - alpha) cos(2 pi p / L), Harris 1978."""


class DelayAndSum:
    """I(u) = |sum_c w_c x_c exp(+j k u p_c)|, eq. (8) of the paper with weights of sum 1.

    The maximum-likelihood estimate of one target without a window. Its resolution is the array's cell lambda / L and
    its sidelobes are those of the array: -13, -5 and -1.5 dB for the paper's three. The paper shows it with a Hann
    window.

    A window weighs each element by its place in the aperture, whether the array is filled or thinned. The aperture L is
    span + spacing, so that the outermost elements of a Hann window keep some weight.

    :param window: "none", "hamming" or "hann"
    """

    def __init__(self, window: Literal["none", "hamming", "hann"] = "none") -> None:
        self.window = window
        self.name = "das" if window == "none" else f"das-{window}"

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] at the angles u [U]; the noise power is not used."""
        constant, places = WINDOWS[self.window], array.positions_m
        centre, aperture = 0.5 * (places.min() + places.max()), array.wavelength_m / array.resolution_cell
        window = constant + (1.0 - constant) * np.cos(2.0 * np.pi * (places - centre) / aperture)
        weights = (window / window.sum())[:, None] * array.manifold(u).conj()
        return image_rows(snapshots, array, len(u), noise_power, lambda x, _: np.abs(x @ weights))
