"""Circular Gaussian numbers: the transform of Box and Muller (Ann. Math. Stat. 29, 610, 1958) of a generator's bits.

Of 64 bits the upper half u gives the radius sqrt(-2 ln u), the lower half the angle. Both vectorise, unlike the
rejection of NumPy's own: a quarter of its time. With 32 bits a radius is at most 6.8 deviations; of 1e10 numbers one
would be larger.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from shared.physics.compiled import compiled
from shared.physics.cycles import short_phasor

_FAST = {"contract", "nsz", "arcp"}
_ONE, _LN_2 = np.float32(1.0), np.float32(np.log(2.0))
_MANTISSA, _EXPONENT_OF_ONE = np.int32(2**23 - 1), np.int32(127 * 2**23)
_L3, _L5, _L7, _L9 = (np.float32(1.0 / n) for n in (3, 5, 7, 9))


def fill_circular(generator: np.random.Generator, deviation: float, noise: Float32[np.ndarray, "*shape 2"]) -> None:
    """Fill re and im with independent normal numbers of this standard deviation."""
    bits = generator.integers(0, 2**64 - 1, noise.size // 2, dtype=np.uint64, endpoint=True)
    box_muller(bits, np.float32(deviation), np.empty(len(bits), dtype=np.float32), noise.reshape(-1))


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def box_muller(bits, deviation, radius, noise):
    """re and im of every 64 bits, one after the other, to ``noise``."""
    as_bits = radius.view(np.int32)
    for k in range(len(bits)):
        # u 2^32, from 1/2 to 2^32: never 0.
        radius[k] = np.float32(np.float64(bits[k] >> np.uint64(32)) + 0.5)
    for k in range(len(bits)):
        # ln u = (exponent - 32) ln 2 + ln m, with ln m = 2 artanh((m - 1) / (m + 1)) about m = sqrt(2).
        exponent = (as_bits[k] >> np.int32(23)) - np.int32(127)
        as_bits[k] = (as_bits[k] & _MANTISSA) | _EXPONENT_OF_ONE
        m = radius[k]
        above = m > np.float32(1.41421356)
        m = np.float32(0.5) * m if above else m
        whole = np.float32(exponent - np.int32(32)) + (_ONE if above else np.float32(0.0))
        s = (m - _ONE) / (m + _ONE)
        q = s * s
        log = np.float32(2.0) * s * (_ONE + q * (_L3 + q * (_L5 + q * (_L7 + q * _L9))))
        radius[k] = deviation * np.sqrt(max(np.float32(-2.0) * (whole * _LN_2 + log), np.float32(0.0)))
    for k in range(len(bits)):
        lower = np.int32(np.uint32(bits[k] & np.uint64(2**32 - 1)))
        cosine, sine = short_phasor(np.float32(lower) * np.float32(2.0**-32))
        noise[2 * k], noise[2 * k + 1] = radius[k] * cosine, radius[k] * sine
