"""Levels that a picture can show: the scale's ends, the weight by range, no target lost between the pixels."""

import numpy as np
import pytest

from shared.pictures import SPAN_DB, hold_peaks, level_db, range_weighted_db


def test_levels_are_cut_at_both_ends_and_an_empty_image_is_the_floor():
    levels = level_db(np.array([[0.0, 1e-6, 0.1, 1.0, 10.0]]), 1.0)
    np.testing.assert_allclose(levels, [[-40.0, -40.0, -20.0, 0.0, 0.0]], atol=1e-9)
    assert (level_db(np.zeros((2, 2)), 0.0) == -40.0).all()


def test_an_echo_that_falls_with_range_keeps_its_level():
    image = np.zeros((9, 3))
    image[2, 0], image[8, 1], image[8, 2] = 4.0, 1.0, 0.1
    levels = range_weighted_db(image)
    assert levels[2, 0] == levels[8, 1] == 0.0
    assert levels[8, 2] == pytest.approx(-20.0)
    assert range_weighted_db(image, reference=10.0 * image)[2, 0] == pytest.approx(-20.0)
    assert range_weighted_db(image, reference=0.1 * image)[2, 0] == 0.0
    assert (range_weighted_db(np.zeros((3, 2))) == -SPAN_DB).all()


@pytest.mark.parametrize("bin_of_row", [(0, 0), (3, 4), (6, 9), (2, 10)])
def test_no_block_loses_its_highest_level(bin_of_row):
    levels = np.full((7, 11), -SPAN_DB)
    levels[bin_of_row] = 0.0
    held, rows, columns = hold_peaks(levels, (3, 3))
    assert (rows, columns, held.shape) == (3, 4, (3, 3))
    assert np.argwhere(held == 0.0).tolist() == [[bin_of_row[0] // 3, bin_of_row[1] // 4]]
