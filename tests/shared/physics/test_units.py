"""Constants, conversions, vectors, unit phasors and range shifts against their definitions; a user's error."""

from __future__ import annotations

import pickle

import mpmath
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

from shared.physics.cycles import phasor
from shared.physics.errors import LONGEST_IN_FIGURE, InputError, figure_text
from shared.physics.units import BOLTZMANN, SPEED_OF_LIGHT, amplitude_to_db, db_to_power, dbm_to_watt, power_to_db
from shared.physics.vectors import dots, lengths, taken
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.sweep import reference_frequency_hz, shift_error_rms, shift_polynomials, sweep_positions


def test_constants_are_those_of_the_si():
    assert constants.speed_of_light == SPEED_OF_LIGHT
    assert constants.Boltzmann == BOLTZMANN


def test_known_levels():
    np.testing.assert_allclose(db_to_power([0.0, 10.0, -30.0]), [1.0, 10.0, 1e-3])
    np.testing.assert_allclose(power_to_db([1.0, 100.0]), [0.0, 20.0], atol=1e-12)
    np.testing.assert_allclose(amplitude_to_db([1.0, -10.0, 10.0j]), [0.0, 20.0, 20.0], atol=1e-12)
    assert dbm_to_watt(30.0) == pytest.approx(1.0)
    assert dbm_to_watt(0.0) == pytest.approx(1e-3)


def test_silence_has_a_finite_level():
    np.testing.assert_allclose(power_to_db([0.0, 1e-300]), -400.0)
    np.testing.assert_allclose(amplitude_to_db(np.zeros(2)), -400.0)
    assert power_to_db(0.0, floor_db=-90.0) == pytest.approx(-90.0)
    assert amplitude_to_db(np.float32(0.0), floor_db=-90.0) == pytest.approx(-90.0)


@pytest.mark.parametrize("expected", ["", "at least 1"])
def test_it_can_be_pickled(expected):
    error = InputError("radar.toml", "chirps = 0,\n at line 3", expected)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is InputError
    assert str(again) == str(error)
    assert "\n" not in str(error)


def test_a_name_that_would_steer_the_terminal_is_shown_escaped():
    error = InputError("scene\x1b[2J.usda", "name = '\u202ekcab\ud800'", "a\x00b")
    assert str(error) == r"scene\x1b[2J.usda: name = '\u202ekcab\ud800'; expected a\x00b"


def test_a_name_is_no_formula_in_a_figure():
    assert figure_text("$\\frac{$\n") == r"\$\frac{\$\n"
    assert len(figure_text(100 * "a")) == LONGEST_IN_FIGURE


GENERATOR = np.random.default_rng(5)
VECTORS, OTHERS = GENERATOR.normal(size=(2, 1000, 3)) * 10.0 ** GENERATOR.integers(-8, 8, (2, 1000, 1))


@pytest.mark.parametrize("shape", [(1000, 3), (10, 100, 3), (0, 3), (3,)])
def test_lengths_are_numpys_to_the_last_bit(shape):
    vectors = VECTORS.reshape(-1)[: int(np.prod(shape))].reshape(shape)
    np.testing.assert_array_equal(lengths(vectors), np.linalg.norm(vectors, axis=-1))


def test_vectors_need_not_stand_together_in_memory():
    np.testing.assert_array_equal(lengths(VECTORS[::3]), np.linalg.norm(VECTORS[::3], axis=1))
    np.testing.assert_array_equal(lengths(VECTORS.T[:, :3]), np.linalg.norm(VECTORS.T[:, :3], axis=1))


def test_dots_are_numpys_to_rounding():
    bound = 4.0 * np.finfo(float).eps * (np.abs(VECTORS) * np.abs(OTHERS)).sum(axis=1)
    assert (np.abs(dots(VECTORS, OTHERS) - np.einsum("ki,ki->k", VECTORS, OTHERS)) <= bound).all()


@pytest.mark.parametrize("index", [np.array([4, 4, 0, -1]), np.zeros(0, dtype=np.int64), VECTORS[:, 0] > 0.0])
@pytest.mark.parametrize("array", [VECTORS, VECTORS[:, 0], VECTORS.reshape(1000, 3, 1)])
def test_rows_are_those_of_indexing(array, index):
    np.testing.assert_array_equal(taken(array, index), array[index])


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
