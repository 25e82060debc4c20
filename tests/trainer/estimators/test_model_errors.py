"""Rows of imperfect channels at 60 dB SNR, with the noise told that :mod:`shared.signal.model_error` gives them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, U, echoes, noise
from scipy.signal import find_peaks

from shared.signal.model_error import NO_MODEL_ERROR_DB, row_noise
from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS, Estimator
from trainer.estimators.fitting import fit_lines
from trainer.estimators.ml import MaximumLikelihood

THERMAL = 1e-6
MODEL_ERROR_DB = -20.0
ROWS = 24
APART_DEG = 7.0
LEAST_DB = -15.0
"""A line of the image less than that below the row's largest is no target: the error of a channel is -20 dB."""
NEAR_CELLS = 0.25
ONE_REFLECTOR = ("iaa", "iaa-view", "omp", "omp-cfar", "spice", "likes", "ml")
"""Delay-and-sum and MUSIC of one snapshot show the array's sidelobes, -5 and -1.5 dB."""
TWO_REFLECTORS = [
    *(("sparse6", name, 0) for name in ("iaa", "iaa-view", "omp-cfar", "spice", "likes", "ml")),
    ("sparse4", "omp-cfar", 0), ("sparse4", "likes", 3), ("sparse4", "ml", 0),
]  # fmt: skip
"""(array, estimator, wrong rows of 24). OMP on a grid, and IAA and SPICE with 12 channels, show more lines at a thermal
SNR of 20 dB too."""


def measured_rows(array: LineArray, targets: int, seed: int = 0) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """(rows [R, C] of unit reflectors at random phases, APART_DEG apart, u [R, K]); each row has a board of its own.

    Gain (of the amplitude) and phase [rad] of each channel have the same deviation; their powers add to the error's.
    """
    generator = np.random.default_rng(seed)
    first = generator.uniform(-35.0, 25.0, ROWS)
    u = np.sin(np.deg2rad(first[:, None] + APART_DEG * np.arange(targets)))
    clean = echoes(array, u, np.exp(2j * np.pi * generator.random(u.shape)))
    deviation = np.sqrt(0.5 * 10.0 ** (MODEL_ERROR_DB / 10.0))
    gain, phase = deviation * generator.standard_normal((2, ROWS, array.channels))
    return clean * (1.0 + gain) * np.exp(1j * phase) + noise(array, ROWS, THERMAL, generator), u


def estimator_of(name: str, targets: int) -> Estimator:
    return MaximumLikelihood(targets) if name == "ml" else ESTIMATORS[name]()


def wrong_rows(image: NDArray[np.float64], u: NDArray[np.float64], array: LineArray) -> int:
    """Rows whose lines above LEAST_DB are not as many as the reflectors, or not each near its own."""
    wrong = 0
    for row, places in zip(image, u, strict=True):
        peaks = find_peaks(np.pad(row, 1), height=max(row.max(), 1e-30) * 10.0 ** (LEAST_DB / 20.0))[0] - 1
        near = len(peaks) == len(places) and np.abs(U[peaks] - places).max() < NEAR_CELLS * array.resolution_cell
        wrong += not near
    return wrong


@pytest.mark.parametrize("name", ONE_REFLECTOR)
@pytest.mark.parametrize("array", ["sparse6", "sparse4"])
def test_one_reflector_is_one_line(array: str, name: str) -> None:
    rows, u = measured_rows(ARRAYS[array], 1)
    told = row_noise(rows, THERMAL, MODEL_ERROR_DB)
    image = estimator_of(name, 1).image(rows, ARRAYS[array], U, told)
    assert wrong_rows(image, u, ARRAYS[array]) == 0


@pytest.mark.parametrize(("array", "name", "wrong"), TWO_REFLECTORS)
def test_two_reflectors_are_two(array: str, name: str, wrong: int) -> None:
    rows, u = measured_rows(ARRAYS[array], 2)
    told = row_noise(rows, THERMAL, MODEL_ERROR_DB)
    image = estimator_of(name, 2).image(rows, ARRAYS[array], U, told)
    assert wrong_rows(image, u, ARRAYS[array]) <= wrong


@pytest.mark.parametrize("array", ["sparse6", "sparse4"])
@pytest.mark.parametrize("targets", [1, 2])
def test_the_line_fit_finds_as_many_from_nothing(array: str, targets: int) -> None:
    rows, u = measured_rows(ARRAYS[array], targets)
    found = fit_lines(rows, ARRAYS[array], THERMAL, np.empty((ROWS, 0)), MODEL_ERROR_DB)
    assert (np.count_nonzero(found.amplitude, axis=1) == targets).all()
    near = NEAR_CELLS * ARRAYS[array].resolution_cell
    assert np.abs(np.sort(found.u[:, :targets], axis=1) - u).max() < near


def test_told_the_thermal_noise_alone_likes_splits_and_the_fit_adds_lines() -> None:
    """Why there is a floor."""
    array = ARRAYS["sparse4"]
    rows, u = measured_rows(array, 2)
    alone = row_noise(rows, THERMAL, NO_MODEL_ERROR_DB)
    assert wrong_rows(ESTIMATORS["likes"]().image(rows, array, U, alone), u, array) >= 5
    found = fit_lines(rows, array, THERMAL, np.empty((ROWS, 0)), NO_MODEL_ERROR_DB)
    assert (np.count_nonzero(found.amplitude, axis=1) > 2).mean() > 0.9


def test_the_second_echo_does_not_hide_the_first_where_the_noise_is_known() -> None:
    """A share of what is left, the rule for one number, returns nothing for some pairs of equal level."""
    array = ARRAYS["sparse6"]
    rows, _ = measured_rows(array, 2)
    estimator = ESTIMATORS["omp-cfar"]()
    by_share = estimator.image(rows, array, U, THERMAL)
    assert 0 < np.count_nonzero(~by_share.any(axis=1)) < ROWS
    known = estimator.image(rows, array, U, row_noise(rows, THERMAL, MODEL_ERROR_DB))
    assert known.any(axis=1).all()
    # Noise alone has a line in at most one row of a hundred.
    alone = noise(array, 400, 1.0, np.random.default_rng(1))
    assert np.count_nonzero(estimator.image(alone, array, U, np.ones(400)).any(axis=1)) <= 10
