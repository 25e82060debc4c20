"""Rows of imperfect channels at 60 dB SNR, with the noise told that :mod:`shared.signal.model_error` gives them."""

import numpy as np
import pytest
from measured_rows import MODEL_ERROR_DB, NEAR_CELLS, ROWS, THERMAL, estimator_of, measured_rows, wrong_rows
from paper_arrays import ARRAYS, U, noise

from shared.signal.model_error import row_noise
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import fit_lines

ONE_REFLECTOR = ("iaa", "iaa-view", "omp", "omp-cfar", "spice", "likes", "ml")
"""Delay-and-sum and MUSIC of one snapshot show the array's sidelobes, -5 and -1.5 dB."""
TWO_REFLECTORS = [
    *(("sparse6", name, 2, 0) for name in ("iaa", "iaa-view", "omp-cfar", "spice", "likes", "ml")),
    ("sparse4", "omp-cfar", 2, 0), ("sparse4", "likes", 2, 3), ("sparse4", "ml", 2, 0),
]  # fmt: skip
"""(array, estimator, reflectors, wrong rows of 24). OMP on a grid, and IAA and SPICE with 12 channels, show more lines
at a thermal SNR of 20 dB too."""


@pytest.mark.parametrize(
    ("array", "name", "reflectors", "wrong"),
    [*((array, name, 1, 0) for array in ("sparse6", "sparse4") for name in ONE_REFLECTOR), *TWO_REFLECTORS],
)
def test_there_are_as_many_lines_as_reflectors(array: str, name: str, reflectors: int, wrong: int) -> None:
    rows, u = measured_rows(ARRAYS[array], reflectors)
    told = row_noise(rows, THERMAL, MODEL_ERROR_DB)
    image = estimator_of(name, reflectors).image(rows, ARRAYS[array], U, told)
    assert wrong_rows(image, u, ARRAYS[array]) <= wrong


@pytest.mark.parametrize("array", ["sparse6", "sparse4"])
@pytest.mark.parametrize("targets", [1, 2])
def test_the_line_fit_finds_as_many_from_nothing(array: str, targets: int) -> None:
    rows, u = measured_rows(ARRAYS[array], targets)
    found = fit_lines(rows, ARRAYS[array], THERMAL, np.empty((ROWS, 0)), MODEL_ERROR_DB)
    assert (np.count_nonzero(found.amplitude, axis=1) == targets).all()
    near = NEAR_CELLS * ARRAYS[array].resolution_cell
    assert np.abs(np.sort(found.u[:, :targets], axis=1) - u).max() < near


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
