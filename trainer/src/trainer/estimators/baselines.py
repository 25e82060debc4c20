"""The paper's baselines: delay-and-sum, the matched filter with a window over the aperture; and MUSIC with the number
of targets by AIC, and what spatial smoothing makes of it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
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
    """

    def __init__(self, window: Literal["none", "hamming", "hann"] = "none") -> None:
        self.window = window

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] at the angles u [U]; the noise power is not used."""
        constant, places = WINDOWS[self.window], array.positions_m
        centre, aperture = 0.5 * (places.min() + places.max()), array.wavelength_m / array.resolution_cell
        window = constant + (1.0 - constant) * np.cos(2.0 * np.pi * (places - centre) / aperture)
        weights = (window / window.sum())[:, None] * array.manifold(u).conj()
        return image_rows(snapshots, array, len(u), noise_power, lambda x, _: np.abs(x @ weights))


EIGENVALUE_FLOOR = 1e-12
"""Relative to the largest: logarithms of eigenvalues that are zero but for rounding."""
SUBARRAY_SHARE = 0.5
"""Elements of a smoothed subarray over those of the line."""


class Music:
    """Pseudo-spectrum of the noise subspace, P(u) = C / (a^H E_n E_n^H a), E_n the eigenvectors after the first K.

    Schmidt 1986; K by AIC (Akaike 1974; Wax and Kailath 1985). MUSIC has no amplitudes: a row is drawn as sqrt(P), its
    maximum set to the row's delay-and-sum maximum [sqrt(W)].

    - "none" is the paper's: the covariance x x^H of one snapshot on any array. It has rank one, so all eigenvalues
      but the first are zero, AIC always finds one target, noise alone included, and P = 1 / (1 - |a^H x|^2 / (C
      |x|^2)) rises with the delay-and-sum image. The peaks are those of delay-and-sum, only sharper: it resolves
      nothing more and keeps every sidelobe. That is the known weakness of this baseline, kept because the paper
      compares with it.
    - "forward-backward" averages over shifted subarrays and their mirror images (Pillai and Kwon 1989), which gives a
      real subspace at the price of half the aperture. Only for uniform lines; a thinned array has no shifted
      copies of itself.

    :param targets: K, where it is known; by AIC where None
    """

    def __init__(self, smoothing: Literal["none", "forward-backward"] = "none", targets: int | None = None) -> None:
        self.smoothing, self.targets = smoothing, targets

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] square root of the pseudo-spectrum [sqrt(W)] of snapshots [R, C] at the angles u [U].

        A row in which AIC finds no target is zero. The noise power is not used.

        :raises InputError: smoothing on an array that is not a uniform line
        """
        places = channels_by_position(array) if self.smoothing == "forward-backward" else None
        positions, elements = array.positions_m, array.channels
        if places is not None:
            positions = positions[places]
            elements = min(max(round(SUBARRAY_SHARE * array.channels), 2), array.channels)
        part = LineArray(positions[:elements], array.wavelength_m)
        manifold, conjugate = part.manifold(u), array.manifold(u).conj()

        def solve(x: NDArray[np.complex128], _: NDArray[np.float64]) -> NDArray[np.float64]:
            data = x[..., None] if places is None else forward_backward(x[:, places], elements)
            spectrum = pseudo_spectrum(data, manifold, self.targets)
            peak = np.abs(x @ conjugate).max(axis=1) / array.channels
            top = spectrum.max(axis=1, keepdims=True)
            return peak[:, None] * np.sqrt(spectrum / np.where(top > 0.0, top, 1.0))

        return image_rows(snapshots, array, len(u), noise_power, solve)


def pseudo_spectrum(
    data: NDArray[np.complex128], manifold: NDArray[np.complex128], targets: int | None = None
) -> NDArray[np.float64]:
    """[B, U] MUSIC pseudo-spectra of data [B, C, N], N snapshots each; zero where there are no targets.

    The eigenvectors of the covariance are the left singular vectors of the data, and E_n E_n^H = I - E_s E_s^H.

    :param manifold: [C, U]
    :param targets: the same number for all; by AIC where None
    """
    _, channels, snapshots = data.shape
    vectors, singular, _ = np.linalg.svd(data, full_matrices=False)
    eigenvalues = np.zeros((len(data), channels))
    eigenvalues[:, : singular.shape[1]] = singular**2 / snapshots
    count = aic_count(eigenvalues, snapshots) if targets is None else np.full(len(data), targets)
    vectors = vectors * (np.arange(singular.shape[1]) < count[:, None])[:, None, :]
    signal = np.sum(np.abs(np.swapaxes(vectors, 1, 2).conj() @ manifold) ** 2, axis=1)
    noise = np.maximum(channels - signal, EIGENVALUE_FLOOR * channels)
    return np.where((count > 0)[:, None], channels / noise, 0.0)


def aic_count(eigenvalues: NDArray[np.float64], snapshots: int) -> NDArray[np.intp]:
    """[B] number of targets by AIC from falling eigenvalues [B, C] of the covariance of N snapshots.

    AIC(k) = -2 N (C - k) ln(geometric mean / arithmetic mean of the last C - k) + 2 k (2 C - k), k < C, the smallest
    wins (Wax and Kailath 1985). Zero eigenvalues are raised to 1e-12 of the largest: equal, they speak for
    no target.
    """
    channels = eigenvalues.shape[1]
    largest = eigenvalues[:, :1]
    relative = np.maximum(eigenvalues / np.where(largest > 0.0, largest, 1.0), EIGENVALUE_FLOOR)
    criterion = np.empty(eigenvalues.shape)
    for k in range(channels):
        tail = relative[:, k:]
        ratio = np.log(tail).mean(axis=1) - np.log(tail.mean(axis=1))
        criterion[:, k] = -2.0 * snapshots * (channels - k) * ratio + 2.0 * k * (2 * channels - k)
    return np.argmin(criterion, axis=1)


def channels_by_position(array: LineArray) -> NDArray[np.intp]:
    """[C] channels by rising position, of a line of equal spacings.

    :raises InputError: an array with gaps or doubled elements
    """
    order = np.argsort(array.positions_m, kind="stable")
    spacing = array.spacing_m
    span = float(np.ptp(array.positions_m))
    if spacing is None or round(span / spacing) != array.channels - 1 or np.diff(array.positions_m[order]).min() <= 0:
        raise InputError(
            "music-fbss", f"an array of {array.channels} channels with gaps", "a uniform line of 2 or more"
        )
    return order


def forward_backward(x: NDArray[np.complex128], elements: int) -> NDArray[np.complex128]:
    """[B, M, 2 L] windows of M elements of uniform snapshots x [B, C], L = C - M + 1, and their conjugates mirrored."""
    forward = np.swapaxes(np.lib.stride_tricks.sliding_window_view(x, elements, axis=1), 1, 2)
    return np.concatenate([forward, forward[:, ::-1].conj()], axis=2)
