"""The error a user can cause crosses from a worker process as it was."""

from __future__ import annotations

import pickle

import pytest

from shared.physics.errors import LONGEST_IN_FIGURE, InputError, figure_text


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
