"""Levels that a picture can show, and where a bin is drawn, however many bins a pixel holds."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from shared.pictures import SPAN_DB, draw_from_above, draw_levels, hold_peaks, level_db, range_weighted_db
from shared.radar import Radar

RADAR = Radar()
ROW, COLUMN = 200, 401
RANGE_M, U = ROW * RADAR.waveform.range_step_m, RADAR.grid.u[COLUMN]


@pytest.fixture
def axis():
    return Figure().subplots()


@pytest.fixture
def levels():
    """An image of several times a panel's pixels, one bin lit."""
    found = np.full((RADAR.waveform.range_bins, RADAR.grid.bins), -SPAN_DB)
    found[ROW, COLUMN] = 0.0
    return found


@pytest.mark.parametrize("first_row", [0, 150])
def test_every_bin_of_a_large_image_is_drawn_in_its_place(axis, levels, first_row):
    step_m, grid = RADAR.waveform.range_step_m, RADAR.grid
    draw_levels(axis, levels[first_row:], step_m, grid.u_start, grid.step, first_row)
    (drawn,) = axis.images
    left, right, near, far = drawn.get_extent()
    (row,), (column,) = np.nonzero(drawn.get_array() == 0.0)
    rows, columns = drawn.get_array().shape
    assert rows < len(levels)
    assert near + (far - near) * (row + 0.5) / rows == pytest.approx(RANGE_M, abs=0.2)
    assert left + (right - left) * (column + 0.5) / columns == pytest.approx(U, abs=0.01)
    assert axis.get_xlim() == pytest.approx((grid.u_stop - 0.5 * grid.step, grid.u_start - 0.5 * grid.step))
    assert axis.get_ylim() == pytest.approx((max(first_row - 0.5, 0.0) * step_m, (len(levels) - 0.5) * step_m))


@pytest.mark.parametrize("pixels", [(700, 500), (100, 90)])
def test_from_above_a_bin_lies_ahead_and_to_its_side_however_few_pixels_there_are(axis, levels, pixels):
    mesh = draw_from_above(axis, levels, RADAR.waveform.range_step_m, RADAR.grid.u, pixels=pixels)
    ((row, column),) = np.argwhere(mesh.get_array() == 0.0)
    corners = np.asarray(mesh.get_coordinates())[row : row + 2, column : column + 2].reshape(4, 2)
    y, x = RANGE_M * U, RANGE_M * np.sqrt(1 - U**2)
    assert ((corners.min(axis=0) <= (y, x)) & ((y, x) <= corners.max(axis=0))).all()
    # Left of the radar is on the left.
    assert axis.get_xlim()[0] > 0.0 > axis.get_xlim()[1]


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
