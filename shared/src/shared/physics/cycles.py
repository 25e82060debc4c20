"""Unit phasors exp(j 2 pi x) of a phase x in cycles, for numba kernels.

The phase is reduced modulo one cycle in float64 before anything else happens to it: at 77 GHz and 200 m it is 1e5
cycles, of which float32 would keep 0.008. The polynomials vectorise; calls into libm do not. The error of
:func:`phasor` is at most 1e-15 over the reduced cycle: ``tests/shared/physics/test_cycles.py`` compares it with mpmath.
"""

from __future__ import annotations

from math import factorial, pi

import numba
import numpy as np
from numba.extending import overload

from shared.physics.compiled import inlined

_FAST = {"contract", "nsz", "arcp"}
# Taylor series of sin and cos of half the angle y = pi r, |y| <= pi / 2; the first term left out is below 2e-17.
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17, _S19, _S21 = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 11)]
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16, _C18, _C20, _C22 = [(-1) ** k / factorial(2 * k) for k in range(1, 12)]


@inlined(error_model="numpy", fastmath=_FAST)
def phasor(cycles: float) -> tuple[float, float]:
    """(cos, sin) of 2 pi ``cycles``; any finite float64."""
    y = pi * (cycles - np.floor(cycles + 0.5))
    q = y * y
    s = _S19 + q * _S21
    s = _S15 + q * (_S17 + q * s)
    s = _S11 + q * (_S13 + q * s)
    s = _S7 + q * (_S9 + q * s)
    s = y + y * q * (_S3 + q * (_S5 + q * s))
    c = _C20 + q * _C22
    c = _C16 + q * (_C18 + q * c)
    c = _C12 + q * (_C14 + q * c)
    c = _C8 + q * (_C10 + q * c)
    c = 1.0 + q * (_C2 + q * (_C4 + q * (_C6 + q * c)))
    return 1.0 - 2.0 * s * s, 2.0 * s * c


# The same series in float32; the first term left out is below 6e-8.
_S3F, _S5F, _S7F, _S9F, _S11F = [np.float32((-1) ** k / factorial(2 * k + 1)) for k in range(1, 6)]
_C2F, _C4F, _C6F, _C8F, _C10F, _C12F = [np.float32((-1) ** k / factorial(2 * k)) for k in range(1, 7)]
_ONE, _TWO, _PIF = np.float32(1.0), np.float32(2.0), np.float32(pi)


@inlined(error_model="numpy", fastmath=_FAST)
def single_phasor(cycles: float) -> tuple[np.float32, np.float32]:
    """:func:`phasor` in float32 once the phase is reduced in float64: within 7e-7, at half the price."""
    return _single_series(np.float32(pi * (cycles - np.floor(cycles + 0.5))))


@inlined(error_model="numpy", fastmath=_FAST)
def short_phasor(cycles: np.float32) -> tuple[np.float32, np.float32]:
    """:func:`single_phasor` of a phase that is reduced already: float32, at most half a cycle."""
    return _single_series(_PIF * cycles)


@inlined(error_model="numpy", fastmath=_FAST)
def _single_series(y: np.float32) -> tuple[np.float32, np.float32]:
    """(cos, sin) of 2 y for abs(y) up to pi / 2."""
    q = y * y
    s = y + y * q * (_S3F + q * (_S5F + q * (_S7F + q * (_S9F + q * _S11F))))
    c = _ONE + q * (_C2F + q * (_C4F + q * (_C6F + q * (_C8F + q * (_C10F + q * _C12F)))))
    return _ONE - _TWO * s * s, _TWO * s * c


def phasor_like(cycles, value):
    """In kernels, the phasor in the precision of ``value``: :func:`single_phasor` for float32, else :func:`phasor`."""
    return single_phasor(cycles) if value.dtype == np.float32 else phasor(cycles)


@overload(phasor_like, inline="always")
def _phasor_like(cycles, value):
    if value == numba.float32:
        return lambda cycles, value: single_phasor(cycles)
    return lambda cycles, value: phasor(cycles)
