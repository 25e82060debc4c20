"""Constants, conversions and vectors against their definitions; a user's error."""

import pickle

import numpy as np
import pytest
from scipy import constants

from shared.physics.errors import LONGEST_IN_FIGURE, InputError, figure_text
from shared.physics.units import BOLTZMANN, SPEED_OF_LIGHT, amplitude_to_db, db_to_power, dbm_to_watt, power_to_db
from shared.physics.vectors import dots, lengths, taken


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
def test_it_can_be_pickled_and_is_one_line_whatever_it_is_made_of(expected):
    error = InputError("radar.toml", "chirps = 0,\n at\u2028line\x853", expected)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is InputError
    assert str(again) == str(error)
    assert len(str(error).splitlines()) == 1


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
