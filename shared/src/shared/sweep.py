"""Small range shifts as polynomials: what lets many echoes, or many pixels, share one FFT.

An echo z bins away from a grid point differs from the grid point's own by exp(j 2 pi z nu) over the sweep position
nu in [-1/2, 1/2). For |z| <= reach this is a polynomial in z whose coefficients are functions of nu alone.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly
from numpy.typing import NDArray
from scipy.special import jv

from shared.radar import Radar


def sweep_positions(samples: int) -> NDArray[np.float64]:
    """[samples] position in the sweep nu = (n - samples // 2) / samples, 0 at the window's centre."""
    return (np.arange(samples) - samples // 2) / samples


def reference_frequency_hz(radar: Radar) -> float:
    """Frequency at nu = 0, the centre of the range window: mid-sweep for an even number of samples [Hz]."""
    waveform = radar.waveform
    return waveform.carrier_hz + waveform.bandwidth_hz * (waveform.samples // 2) / waveform.samples


def shift_polynomials(nu: NDArray[np.float64], reach: float, terms: int) -> NDArray[np.complex128]:
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


def shift_error(reach: float, terms: int) -> float:
    """Bound on the error of :func:`shift_polynomials` anywhere in the sweep: the sum of the terms left out."""
    left_out = np.arange(terms, terms + 40)
    return float(2.0 * np.abs(jv(left_out, np.pi * reach)).sum())
