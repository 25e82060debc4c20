"""Small range shifts as polynomials: what lets many echoes, or many pixels, share one FFT.

An echo z bins away from a grid point differs from the grid point's own by exp(j 2 pi z nu) over the sweep position
nu in [-1/2, 1/2). For |z| <= reach this is a polynomial in z whose coefficients are functions of nu alone, and each of
these functions is a sum of a few shifts by whole cells of a finer grid: what lets all terms share one FFT.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex128, Float, Float64
from numpy.polynomial.chebyshev import cheb2poly
from scipy.special import jv

from shared.radar import Radar


def sweep_positions(samples: int) -> Float64[np.ndarray, " {samples}"]:
    """[samples] position in the sweep nu = (n - samples // 2) / samples, 0 at the window's centre."""
    return (np.arange(samples) - samples // 2) / samples


def reference_frequency_hz(radar: Radar) -> float:
    """Frequency at nu = 0, the centre of the range window: mid-sweep for an even number of samples [Hz]."""
    waveform = radar.waveform
    return waveform.carrier_hz + waveform.bandwidth_hz * (waveform.samples // 2) / waveform.samples


def shift_polynomials(
    nu: Float[np.ndarray, " samples"], reach: float, terms: int
) -> Complex128[np.ndarray, "{terms} samples"]:
    """[terms, N] coefficients q_p(nu) of exp(j 2 pi z nu) = sum_p z^p q_p(nu) for |z| <= ``reach`` [bins].

    The Jacobi-Anger expansion exp(j a x) = J_0(a) + 2 sum_d j^d J_d(a) T_d(x) (DLMF 10.12.3) with a = 2 pi reach nu and
    x = z / reach, cut after ``terms`` terms and rearranged into powers of z. Its error is about 2 J_terms(pi reach) at
    the ends of the sweep, near the least that any polynomial of this degree can have, and far less at its centre.
    """
    argument = 2.0 * np.pi * reach * nu
    order = np.arange(terms)
    weight = np.where(order == 0, 1.0, 2.0) * 1j**order
    polynomials = np.zeros((terms, len(nu)), dtype=np.complex128)
    for d in order:
        powers = cheb2poly(np.eye(terms)[d])[: d + 1]
        for p, coefficient in enumerate(powers):
            polynomials[p] += coefficient / reach**p * weight[d] * jv(d, argument)
    return polynomials


def shift_error_rms(nu: Float[np.ndarray, " samples"], reach: float, terms: int) -> float:
    """Bound on the root mean square error of :func:`shift_polynomials` over the sweep ``nu``, for any |z| <= reach.

    The terms left out grow as nu^terms, so that the mean over the sweep is far below what its ends have. Those of even
    order are real and those of odd order imaginary.
    """
    left_out = 2.0 * np.abs(jv(np.arange(terms, terms + 40)[:, None], 2.0 * np.pi * reach * np.abs(nu)))
    return float(np.sqrt(np.mean(left_out[0::2].sum(axis=0) ** 2 + left_out[1::2].sum(axis=0) ** 2)))


def shift_weights(
    nu: Float[np.ndarray, " samples"], reach: float, terms: int, taps: int, oversampling: float
) -> tuple[Float64[np.ndarray, " samples"], Float64[np.ndarray, "{taps} {terms}"]]:
    """Polynomials of the shift as weights on a grid of ``oversampling`` cells a bin: gain [N], weights [taps, terms].

        q_p(nu) = gain(nu) sum_j weights[j, p] exp(j 2 pi (j - taps // 2) nu / oversampling)

    The gain undoes a Kaiser-Bessel window ``taps`` cells wide, as in gridding (Jackson et al. 1991, IEEE Trans. Med.
    Imaging 10, 473), which keeps the weights of order one and their errors off the sweep's ends; the weights are the
    least squares fit over the sweep. They are real, because q_p is real for even p and imaginary for odd p.

    :param taps: an odd number of cells
    """
    polynomials = shift_polynomials(nu, reach, terms)
    shape = np.pi * taps * (1.0 - 0.5 / oversampling)
    root = np.sqrt(shape**2 - (np.pi * taps * nu / oversampling) ** 2)
    gain = np.sinh(shape) / shape * root / np.sinh(root)
    offset = np.arange(taps) - taps // 2
    shifts = gain[:, None] * np.exp(2j * np.pi * nu[:, None] * offset / oversampling)
    weights = np.linalg.lstsq(
        np.concatenate([shifts.real, shifts.imag]), np.concatenate([polynomials.real, polynomials.imag], axis=1).T
    )[0]
    return gain, weights


def shift_weights_error(
    nu: Float[np.ndarray, " samples"],
    reach: float,
    gain: Float[np.ndarray, " samples"],
    weights: Float[np.ndarray, "taps terms"],
    oversampling: float,
) -> float:
    """Root mean square error over the sweep of :func:`shift_weights`, for the worst of 129 shifts within the reach."""
    z = np.linspace(-reach, reach, 129)
    taps, terms = weights.shape
    shifts = np.exp(2j * np.pi * nu * (np.arange(taps) - taps // 2)[:, None] / oversampling)
    error = gain * (z[:, None] ** np.arange(terms) @ weights.T @ shifts) - np.exp(2j * np.pi * z[:, None] * nu)
    return float(np.sqrt(np.mean(np.abs(error) ** 2, axis=1)).max())
