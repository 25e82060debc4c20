"""The slow-time factor of a path as weights of Doppler lines, from its values at a few instants of the frame.

The lines stand LINE_OVERSAMPLING to a Doppler bin. A path is anchored midway between two of them, at most half a
spacing away. What the anchor leaves of its phase, s(eta) in cycles, turns slowly: |s'| is at most the *reach*. Its
values V at a few Chebyshev points of the frame determine it, and give the weights of ``taps`` neighbouring lines,

    exp(j 2 pi s(eta)) = gain(eta) sum_t b_t exp(j 2 pi o_t eta),      b = P V,      o_t = (t - (taps - 1) / 2) / h,

with the gain of :func:`shared.signal.sweep.shift_weights`. P is the least squares fit over tones and chirps within the
reach; small singular values are cut, so that P stays small and float32 serves. Nodes and lines are symmetric: reversed
in its lines or in its nodes, P is its own conjugate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Complex64, Complex128, Float64

from shared.signal.sweep import shift_error_rms, shift_polynomials

LINE_OVERSAMPLING = 1.5
"""Lines in a Doppler bin, h. With 2 the lines are a third more, and so is the work that every frame has; with 1.25 a
path takes 2 to 4 lines more."""
POINTS = 97
"""Of the frame at which the weights are fitted and their errors taken."""
TONES = 17
"""Within the reach, of each curvature, that the weights are fitted to."""
CUTS = (1.0, 0.1, 0.01)
"""Singular values below one of these shares of the error, relative to the largest, are cut: large cuts keep the weights
small and with them the rounding, small cuts keep the fit."""
ROUNDING = 1e-7
"""Of a value at a node: float32 phasors and products."""
MOST_TAPS = 48
FEWEST_TERMS, MANY_TERMS = 4, 10
"""Of the polynomial in an element's own Doppler."""
FEW_REACH = 0.13
"""Doppler of an element beyond its centre's [cycles a frame] up to which few terms have to serve: four do at 1e-3, six
at 1e-6. With 0.18, seven at 1e-6, the cube of ``make bench`` takes a tenth longer there; 0.08 is no faster."""


@dataclass(frozen=True, eq=False)
class LineWeights:
    """What turns values at the nodes into weights of lines.

    :param node: positions in the frame, rising, symmetric
    :param lines: P of the module
    :param error: root mean square over the frame for the worst tone or chirp within the reach, with rounding
    :param gain_taps: width of the window that the gain undoes
    """

    node: Float64[np.ndarray, " nodes"]
    lines: Complex64[np.ndarray, "taps nodes"]
    error: float
    gain_taps: int

    @property
    def taps(self) -> int:
        """Lines that a path is spread over."""
        return len(self.lines)


def line_shape(taps: int) -> float:
    """Parameter of the Kaiser-Bessel window, ``taps`` lines wide, of :func:`shared.signal.sweep.shift_weights`."""
    return float(np.pi * taps * (1.0 - 0.5 / LINE_OVERSAMPLING))


def line_gain(eta: Float64[np.ndarray, " points"], taps: int) -> Float64[np.ndarray, " points"]:
    """The gain over the frame that undoes the window of ``taps`` lines."""
    shape = line_shape(taps)
    root = np.sqrt(shape**2 - (np.pi * taps * eta / LINE_OVERSAMPLING) ** 2)
    return np.sinh(shape) / shape * root / np.sinh(root)


@lru_cache(maxsize=32)
def line_weights(extra: float, error: float, half: float, gain_taps: int | None = None) -> LineWeights | None:
    """The fewest lines, and as many nodes, whose error stays below ``error``; None where MOST_TAPS do not suffice.

    :param extra: |s'| beyond half a spacing [cycles a frame], by curvature or an element's own Doppler
    :param half: end of the frame: eta from -half to half
    :param gain_taps: width of the window that the gain undoes; the number of lines by default
    """
    for taps in range(4, MOST_TAPS + 1, 2):
        weights = min((_weights(extra, taps, half, gain_taps or taps, cut * error) for cut in CUTS), key=_error)
        if weights.error <= error:
            return weights
    return None


def _error(weights: LineWeights) -> float:
    return weights.error


def _weights(extra: float, taps: int, half: float, gain_taps: int, cut: float) -> LineWeights:
    eta = np.linspace(-half, half, POINTS)
    node = half * np.cos(np.pi * (np.arange(taps) + 0.5) / taps)[::-1]
    offset = (np.arange(taps) - 0.5 * (taps - 1)) / LINE_OVERSAMPLING
    lines = line_gain(eta, gain_taps)[:, None] * np.exp(2j * np.pi * eta[:, None] * offset)
    wanted, values = _slow_signals(extra, eta), _slow_signals(extra, node)
    matrix = np.linalg.pinv(lines, cut) @ wanted @ np.linalg.pinv(values, cut)
    quarter = 0.5 * (matrix + matrix[:, ::-1].conj())[: taps // 2, : taps // 2].astype(np.complex64)
    half_of_lines = np.concatenate([quarter, quarter[:, ::-1].conj()], axis=1)
    symmetric = np.concatenate([half_of_lines, half_of_lines[::-1].conj()])
    fit = float(np.sqrt(np.mean(np.abs(lines @ (symmetric @ values) - wanted) ** 2, axis=0)).max())
    rounding = ROUNDING * float(np.sqrt(np.mean(np.sum(np.abs(lines @ matrix) ** 2, axis=1))))
    return LineWeights(node, symmetric, float(np.hypot(fit, rounding)), gain_taps)


def _slow_signals(extra: float, eta: Float64[np.ndarray, " points"]) -> Complex128[np.ndarray, "points signals"]:
    """Tones and chirps whose frequency stays within half a spacing and ``extra``."""
    reach = 0.5 / LINE_OVERSAMPLING + extra
    phases = [
        np.linspace(-(reach - abs(curvature)), reach - abs(curvature), TONES) * eta[:, None]
        + curvature * eta[:, None] ** 2
        for curvature in (-extra, -0.5 * extra, 0.0, 0.5 * extra, extra)
    ]
    return np.exp(2j * np.pi * np.concatenate(phases, axis=1))


@lru_cache(maxsize=64)
def element_reach(terms: int, error: float, half: float) -> float:
    """The largest Doppler of an element beyond its centre's [cycles a frame] at which a polynomial of so many terms
    keeps ``error``, as a root mean square over the frame."""
    eta, least, most = np.linspace(-half, half, POINTS), 0.0, 4.0
    while most - least > 1e-3 * most:
        middle = 0.5 * (least + most)
        least, most = (middle, most) if shift_error_rms(eta, middle, terms) <= error else (least, middle)
    return least


@lru_cache(maxsize=8)
def few_terms(error: float, half: float) -> int:
    """The fewest terms that keep ``error``, a root mean square over the frame, up to FEW_REACH."""
    serve = (terms for terms in range(FEWEST_TERMS, MANY_TERMS) if element_reach(terms, error, half) >= FEW_REACH)
    return next(serve, MANY_TERMS)


@lru_cache(maxsize=32)
def element_weights(weights: LineWeights, reach: float, terms: int) -> Float64[np.ndarray, "coefficients values"]:
    """The coefficients of every line, [line, power of d, re and im], from re and im of the values at the nodes.

    A line's weight for an element whose Doppler is d beyond the centre's, up to ``reach``, is their polynomial in d.
    """
    powers = shift_polynomials(weights.node, reach, terms)
    matrix = np.einsum("tn,pn->ntp", weights.lines.astype(np.complex128), powers)
    by_re = np.stack([matrix.real, matrix.imag], axis=-1)
    by_im = np.stack([-matrix.imag, matrix.real], axis=-1)
    return np.ascontiguousarray(np.stack([by_re, by_im], axis=1).reshape(2 * weights.taps, -1).T)
