"""The polynomials of the kernels: unit phasors and range shifts, each against its definition."""

import mpmath
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.physics.cycles import phasor
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.sweep import reference_frequency_hz, shift_error_rms, shift_polynomials, sweep_positions


@numba.njit
def _phasor(cycles: float) -> tuple[float, float]:
    return phasor(cycles)


@given(st.one_of(st.floats(-0.5, 0.5), st.integers(-4000, 4000).map(lambda k: k / 8.0), st.floats(-1e9, 1e9)))
def test_phasor_is_exact_to_1e_15(cycles):
    # x - round(x) is exact in float64 (Sterbenz), so that even 1e6 cycles lose nothing more.
    cosine, sine = _phasor(cycles)
    with mpmath.workdps(40):
        angle = 2 * mpmath.pi * mpmath.mpf(cycles)
        assert abs(cosine - mpmath.cos(angle)) < 1e-15
        assert abs(sine - mpmath.sin(angle)) < 1e-15


@pytest.mark.parametrize("samples", [1, 2, 7, 64])
def test_sweep_positions_are_centred_on_the_window(samples):
    nu = sweep_positions(samples)
    assert nu[samples // 2] == 0.0
    assert nu.min() >= -0.5
    assert nu.max() < 0.5
    radar = Radar(waveform=Waveform(samples=samples, range_bins=1))
    expected = 77e9 + 1e9 * (samples // 2) / samples
    assert reference_frequency_hz(radar) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("reach", [0.25, 0.8, 1.5])
@pytest.mark.parametrize("terms", [1, 3, 5, 9, 14])
def test_shift_polynomials_keep_their_bound(reach, terms):
    nu = sweep_positions(65)
    z = np.linspace(-reach, reach, 101)
    polynomials = shift_polynomials(nu, reach, terms)
    approximate = np.einsum("zp,pn->zn", z[:, None] ** np.arange(terms), polynomials)
    of_samples = np.abs(approximate - np.exp(2j * np.pi * z[:, None] * nu))
    error = np.sqrt(np.mean(of_samples**2, axis=1)).max()
    bound = shift_error_rms(nu, reach, terms)
    assert error <= bound + 1e-13
    # The first term left out grows no faster than |nu|^terms, whose mean square is 1 / (2 terms + 1) of that at the
    # sweep's ends: no sample is off by more than 3.3 (5 terms) or 5.4 (14 terms) times the bound. Found: 3.1 and 4.4.
    assert of_samples.max() <= np.sqrt(2.0 * terms + 1.0) * bound + 1e-13
    # The bound is no more pessimistic than the triangle inequality makes it.
    assert bound < 4.0 * error + 1e-12
