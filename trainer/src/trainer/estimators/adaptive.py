"""Adaptive spectra of one snapshot: IAA, SPICE, LIKES, and what a long line would see of the echoes that IAA finds.

All iterate powers P_n >= 0 of a model R = sum_n P_n a_n a_n^H + sigma^2 I over the whole period of u, not only over the
angles shown: what comes from beyond them would otherwise be explained by wrong ones. They begin with delay-and-sum, and
each step follows from q = a^H R^-1 x and s = a^H R^-1 a alone (:func:`shared.signal.adaptive.adaptive_forms`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shared.processes.defaults import TRUTH_WINDOW
from shared.signal.adaptive import (
    PRIOR_EXPONENT,
    AdaptiveTables,
    adaptive_forms,
    adaptive_powers,
    likes_ratio,
    line_tables,
)
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
ELEMENTS = 256
"""Of the line of the view: the virtual sensor of the paper."""
FLOOR = 1e-6
"""Least power of white noise in a covariance, of the power in a channel. The form a^H R^-1 a is wrong by some
(power / noise)^2 x 2e-16 where R was inverted as a whole: 1e-3 with this floor, everything with 1e-9."""
forms = partial(adaptive_forms, floor=FLOOR, least=0.0)
iaa_powers = partial(adaptive_powers, floor=FLOOR, least=0.0)

Prior = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Angles [N] to how far echoes of each row are expected there [R, N]."""


def scan_tables(array: LineArray, u: NDArray[np.floating]) -> tuple[AdaptiveTables, NDArray[np.intp]]:
    """(tables of the scanned angles, [U] where among them each of ``u`` stands)."""
    axis, shown = scan_axis(array, u)
    return line_tables(array.positions_m, array.wavelength_m, axis), shown


class IterativeAdaptive:
    """s(u) = a^H R^-1 x / a^H R^-1 a,   R = sum_n |s(u_n)|^2 a_n a_n^H, repeated from delay-and-sum on.

    Yardibi, Li, Stoica, Xue and Baggeroer, "Source localization and sensing: a nonparametric iterative adaptive
    approach based on weighted least squares", IEEE Trans. Aerosp. Electron. Syst. 46(1), 2010. No model order, no noise
    power, but a floor 60 dB below the power in the row; amplitudes are nearly unbiased. Two targets closer than about
    half a cell merge.
    """

    iterations = IAA_ITERATIONS
    """After the first, which is delay-and-sum."""

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] at the angles u [U]; the noise power is not used."""
        tables, shown = scan_tables(array, u)

        def solve(x: NDArray[np.complex128], _: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.sqrt(iaa_powers(x, np.zeros(len(x)), tables, self.iterations)[:, shown])

        return image_rows(snapshots, array, len(u), noise_power, solve)


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
        self.iterations = LIKES_ITERATIONS if reweighted else SPICE_ITERATIONS

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] magnitude [sqrt(W)] of snapshots [R, C] with noise of ``noise_power`` [W] at the angles u [U]."""
        tables, shown = scan_tables(array, u)

        def solve(x: NDArray[np.complex128], noise: NDArray[np.float64]) -> NDArray[np.float64]:
            channel_power = np.mean(np.abs(x) ** 2, axis=1)
            noise = np.maximum(noise, FLOOR * channel_power)
            weight = np.sqrt(channel_power)[:, None]
            power = adaptive_powers(x, noise, tables, 0)
            for _ in range(self.iterations):
                filtered, form = adaptive_forms(power, x, noise, tables, floor=0.0, least=0.0)
                estimate = power * np.abs(filtered)
                power = estimate * (np.abs(filtered) / form if self.reweighted else weight)
            return np.asarray(estimate[:, shown])

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
        tables = line_tables(array.positions_m, array.wavelength_m, axis)
        places = 0.5 * array.wavelength_m * (np.arange(ELEMENTS) - 0.5 * (ELEMENTS - 1))
        weights = angle_window(TRUTH_WINDOW, ELEMENTS)[:, None] / ELEMENTS
        seen = manifold(places, array.wavelength_m, axis).T
        line = seen @ (weights * manifold(places, array.wavelength_m, np.asarray(u)).conj())  # (N, U)

        def solve(
            x: NDArray[np.complex128], noise: NDArray[np.float64], known: NDArray[np.float64] | float = 1.0
        ) -> NDArray[np.float64]:
            power = iaa_powers(x, np.zeros(len(x)), tables, self.iterations, known)
            for _ in range(self.sharpening):
                power = power * likes_ratio(*forms(power, x, noise, tables)) * np.asarray(known) ** PRIOR_EXPONENT
            filtered, _ = forms(power, x, noise, tables)
            return np.asarray(np.abs((power * filtered) @ line))

        known = None if prior is None or not self.told else over_period(prior, array, axis)
        return image_rows(snapshots, array, len(u), noise_power, solve, known)
