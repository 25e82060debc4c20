"""Unit phasors exp(j 2 pi x) of a phase x in cycles, for numba kernels.

The phase is reduced modulo one cycle in float64 before anything else happens to it: at 77 GHz and 200 m it is 1e5
cycles, of which float32 would keep 0.008. The polynomials vectorise, which calls into libm do not. The error is at
most 1e-15 over the reduced cycle (``tests/shared/test_cycles.py`` holds it against mpmath).
"""

from __future__ import annotations

from math import factorial, floor, pi

import numba

# Taylor series of sin and cos of half the angle y = pi r, |y| <= pi / 2; the first term left out is below 2e-17.
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17, _S19, _S21 = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 11)]
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16, _C18, _C20, _C22 = [(-1) ** k / factorial(2 * k) for k in range(1, 12)]


@numba.njit(inline="always", error_model="numpy")
def phasor(cycles: float) -> tuple[float, float]:
    """(cos, sin) of 2 pi ``cycles``; any finite float64."""
    y = pi * (cycles - floor(cycles + 0.5))
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
