"""The error a user can cause crosses from a worker process as it was."""

from __future__ import annotations

import pickle

import pytest

from shared.physics.errors import InputError


@pytest.mark.parametrize("expected", ["", "at least 1"])
def test_it_can_be_pickled(expected):
    error = InputError("radar.toml", "chirps = 0,\n at line 3", expected)
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is InputError
    assert str(again) == str(error)
    assert "\n" not in str(error)
