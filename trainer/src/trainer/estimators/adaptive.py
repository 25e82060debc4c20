"""Adaptive spectra of one snapshot: IAA, SPICE, LIKES, and what a long line would see of the echoes that IAA finds.

All iterate powers P_n >= 0 of a model R = sum_n P_n a_n a_n^H + sigma^2 I over the whole period of u, not only over the
angles shown: what comes from beyond them would otherwise be explained by wrong ones. They begin with delay-and-sum, and
each step follows from R^-1 alone (:class:`Scan`).

The covariance of uncorrelated sources of power P_n at u_n on a line depends on the distance alone,

    R_cd = r(p_c - p_d),   r(l) = sum_n P_n exp(-j k u_n l),   r(-l) = r(l)*

and so does the form that the Capon family divides by, for a Hermitian matrix M:

    a(u)^H M a(u) = sum_(l >= 0) w_l Re[ m_l exp(j k u l) ],   m_l = sum_(p_c - p_d = l) M_cd,   w_0 = 1, else 2.

48 elements on a grid have 48 distances and 2304 pairs: that is the work saved. Any other line works, with more of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from shared.signal.adaptive import PRIOR_EXPONENT
from shared.signal.signal import manifold
from shared.signal.windows import angle_window
from trainer.estimators.array import LineArray, NoisePower, image_rows, scan_axis

IAA_ITERATIONS = 15
"""Yardibi et al. report convergence within some 10 to 15."""
SPICE_ITERATIONS, LIKES_ITERATIONS = 60, 12
"""LIKES resolves as many pairs with these as with 30 steps of its paper; SPICE, of first order, converges slowly."""
VIEW_ITERATIONS = 5
"""More make the powers sparser, and the view of extended targets with them."""
SHARP_ITERATIONS = (4, 5)
"""Of IAA, then of LIKES, of the sharper view."""
ELEMENTS, WINDOW = 256, "taylor-30"
"""Of the line of the view: the virtual sensor of the paper and the datasets' default truth."""
DISTANCE_DIGITS = 8
"""Distances that agree to this many decimals of a wavelength are one, that of the first such pair."""
FLOOR = 1e-6
"""Least power of white noise in a covariance, of the power in a channel. The form a^H R^-1 a is wrong by some
(power / noise)^2 x 2e-16 where R was inverted as a whole: 1e-3 with this floor, everything with 1e-9."""

Prior = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Angles [N] to how far echoes of each row are expected there [R, N]."""


class Scan:
    """N scanned angles, seen by a line of elements: the distances of its pairs, and their phases.

    :param u: [N] angles
    """

    def __init__(self, array: LineArray, u: NDArray[np.float64]) -> None:
        self.conjugate = array.manifold(u).conj()  # (C, N)
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

    def begin(self, x: NDArray[np.complex128]) -> NDArray[np.float64]:
        """[B, N] magnitudes |s(u)| of delay-and-sum of snapshots x [B, C]."""
        return np.abs(x @ self.conjugate) / x.shape[1]

    def inverse(
        self, power: NDArray[np.float64], noise: NDArray[np.float64] | float, floor: float = FLOOR
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """([B, C, C] R^-1, [B] trace(R) / C) of powers [B, N] and noise sigma^2 [B].

        :param floor: least sigma^2, of the power in a channel
        """
        covariance = self.covariance(power)
        total = covariance[:, 0, 0].real.copy()
        loading = np.maximum(noise, floor * total)
        diagonal = np.arange(covariance.shape[-1])
        covariance[:, diagonal, diagonal] += loading[:, None]
        return np.asarray(np.linalg.inv(covariance), dtype=np.complex128), total + loading

    def filtered(self, inverse: NDArray[np.complex128], x: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """[B, N] a^H R^-1 x of snapshots [B, C]."""
        return np.asarray(np.einsum("bcd,bd->bc", inverse, x) @ self.conjugate)

    def form(self, inverse: NDArray[np.complex128], channel_power: NDArray[np.float64]) -> NDArray[np.float64]:
        """[B, N] a^H R^-1 a, which is at least C / trace(R): what is less is rounding.

        :param channel_power: [B] trace(R) / C
        """
        return np.maximum(self.quadratic_form(inverse), 1.0 / channel_power[:, None])


class IterativeAdaptive:
    """s(u) = a^H R^-1 x / a^H R^-1 a,   R = sum_n |s(u_n)|^2 a_n a_n^H, repeated from delay-and-sum on.

    Yardibi, Li, Stoica, Xue and Baggeroer, "Source localization and sensing: a nonparametric iterative adaptive
    approach based on weighted least squares", IEEE Trans. Aerosp. Electron. Syst. 46(1), 2010. No model order, no noise
    power, but a floor 60 dB below the power in the row; amplitudes are nearly unbiased. Two targets closer than about
    half a cell merge.
    """

    name = "iaa"
    iterations = IAA_ITERATIONS
    """After the first, which is delay-and-sum."""

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] at the angles u [U]; the noise power is not used."""
        axis, shown = scan_axis(array, u)
        scan = Scan(array, axis)

        def solve(x: NDArray[np.complex128], _: NDArray[np.float64]) -> NDArray[np.float64]:
            return adaptive_amplitudes(x, scan, self.iterations)[:, shown]

        return image_rows(snapshots, array, len(u), noise_power, solve)


def adaptive_amplitudes(
    x: NDArray[np.complex128], scan: Scan, iterations: int, prior: NDArray[np.float64] | float = 1.0
) -> NDArray[np.float64]:
    """[B, N] |s(u)| of snapshots x [B, C] at the scanned angles.

    :param prior: [B, N] by which each iteration multiplies the power, see :mod:`shared.signal.adaptive`
    """
    amplitude, weight = scan.begin(x), np.sqrt(prior)
    for _ in range(iterations):
        inverse, channel_power = scan.inverse(amplitude**2, 0.0)
        amplitude = np.abs(scan.filtered(inverse, x)) / scan.form(inverse, channel_power) * weight
    return amplitude


class SparseCovariance:
    """Sparse covariance fitting: SPICE, an l1 method, and LIKES, its likelihood; the image is |P_n a_n^H R^-1 x|.

    Multiplicative updates from delay-and-sum on:

        SPICE   P_n <- P_n |a_n^H R^-1 x| |x| / sqrt(C)                   min x^H R^-1 x + sum_n P_n C / |x|^2
        LIKES   P_n <- P_n |a_n^H R^-1 x|^2 / (a_n^H R^-1 a_n)            min x^H R^-1 x + ln det R

    Stoica, Babu and Li, "SPICE: a sparse covariance-based estimation method for array processing", IEEE Trans. Signal
    Process. 59(2), 2011; Stoica and Babu, "SPICE and LIKES: two hyperparameter-free methods for sparse-parameter
    estimation", Signal Process. 92, 2012. LIKES takes the square of its paper's step, with the same fixed points
    (:mod:`shared.signal.adaptive`). For one snapshot SPICE is a square-root LASSO (Rojas, Katselis and
    Hjalmarsson 2013) and shrinks amplitudes; LIKES is the maximum likelihood of random amplitudes, and needs no
    number of targets. The noise power is the receiver's, known here. The image holds
    amplitudes expected from R: those of noise shrink to next to nothing.

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
        axis, shown = scan_axis(array, u)
        scan = Scan(array, axis)

        def solve(x: NDArray[np.complex128], noise: NDArray[np.float64]) -> NDArray[np.float64]:
            energy = np.sum(np.abs(x) ** 2, axis=1)
            noise = np.maximum(noise, FLOOR * energy / array.channels)
            weight = np.sqrt(energy / array.channels)[:, None]
            power = scan.begin(x) ** 2
            filtered = np.zeros_like(power)
            for _ in range(self.iterations):
                inverse, channel_power = scan.inverse(power, noise, floor=0.0)
                filtered = np.abs(scan.filtered(inverse, x))
                if self.reweighted:
                    weight = filtered / scan.form(inverse, channel_power)
                estimate, power = power * filtered, power * filtered * weight
            return estimate[:, shown]

        return image_rows(snapshots, array, len(u), noise_power, solve)


def over_period(prior: Prior, array: LineArray, axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """[R, N] the prior at scanned angles, each of which stands for all that the array takes for it: the largest."""
    period = 2.0 * array.half_period
    most = int(2.0 / period) + 1 if array.half_period < 1.0 else 0
    angles = axis + period * np.arange(-most, most + 1)[:, None]
    real = (np.abs(angles) <= 1.0) | (angles == axis)
    known = prior(angles[real])
    each = np.zeros((len(known), *angles.shape))
    each[:, real] = known
    return np.asarray(each.max(axis=1))


class VirtualView:
    """|sum_n h(u - u_n) P_n a_n^H R^-1 x|,   R = sum_n P_n a_n a_n^H + sigma^2 I,   P_n = |s(u_n)|^2 of IAA.

    P_n a_n^H R^-1 x is the mean of an echo from u_n of power P_n, given the snapshot: the echoes add with their phases
    as they would on the line, whose windowed response is h. A spectrum's peak is as wide as the array leaves it; a
    truth image has the line's width, and its sum of several echoes. No training: how far the physics goes alone.

    The line has half a wavelength between its elements and stands in the middle of the radar frame.

    :param sharp: :data:`SHARP_ITERATIONS` of IAA and of LIKES (:class:`SparseCovariance`) in place of IAA alone
    :param told: :meth:`image` uses a prior, where it is given one
    """

    def __init__(self, sharp: bool = False, told: bool = False) -> None:
        self.iterations, self.sharpening = SHARP_ITERATIONS if sharp else (VIEW_ITERATIONS, 0)
        self.told = told
        self.name = ("likes-view" if sharp else "iaa-view") + ("-ego" if told else "")

    def image(
        self,
        snapshots: NDArray[np.complexfloating],
        array: LineArray,
        u: NDArray[np.floating],
        noise_power: NoisePower,
        prior: Prior | None = None,
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] with noise of ``noise_power`` [W] at the angles u [U].

        :param prior: how far echoes are expected at angles [N], as [R, N] of at most 1, see
            :meth:`shared.signal.ego_motion.StaticWorld.prior`
        """
        axis, _ = scan_axis(array, u)
        scan = Scan(array, axis)
        places = 0.5 * array.wavelength_m * (np.arange(ELEMENTS) - 0.5 * (ELEMENTS - 1))
        weights = angle_window(WINDOW, ELEMENTS)[:, None] / ELEMENTS
        seen = manifold(places, array.wavelength_m, axis).T
        line = seen @ (weights * manifold(places, array.wavelength_m, np.asarray(u)).conj())  # (N, U)

        def solve(
            x: NDArray[np.complex128], noise: NDArray[np.float64], known: NDArray[np.float64] | float = 1.0
        ) -> NDArray[np.float64]:
            power = adaptive_amplitudes(x, scan, self.iterations, known) ** 2
            for _ in range(self.sharpening):
                inverse, channel_power = scan.inverse(power, noise)
                ratio = np.abs(scan.filtered(inverse, x)) ** 2 / scan.form(inverse, channel_power)
                power = power * ratio * np.asarray(known) ** PRIOR_EXPONENT
            inverse, _ = scan.inverse(power, noise)
            return np.asarray(np.abs((power * scan.filtered(inverse, x)) @ line))

        known = None if prior is None or not self.told else over_period(prior, array, axis)
        return image_rows(snapshots, array, len(u), noise_power, solve, known)
