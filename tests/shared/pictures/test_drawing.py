"""Where a bin is drawn: over u and from above, however many bins a pixel holds."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from shared.pictures import SPAN_DB, draw_from_above, draw_levels
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


def test_from_above_a_bin_lies_ahead_and_to_its_side(axis, levels):
    mesh = draw_from_above(axis, levels, RADAR.waveform.range_step_m, RADAR.grid.u, pixels=(700, 500))
    held = mesh.get_array()
    ((row, column),) = np.argwhere(held == 0.0)
    corners = np.asarray(mesh.get_coordinates())[row : row + 2, column : column + 2].reshape(4, 2)
    y, x = corners.mean(axis=0)
    assert (x, y) == pytest.approx((RANGE_M * np.sqrt(1 - U**2), RANGE_M * U), abs=0.01)
    # Left of the radar is on the left.
    assert axis.get_xlim()[0] > 0.0 > axis.get_xlim()[1]


def test_from_above_no_echo_is_lost_between_the_pixels(axis, levels):
    mesh = draw_from_above(axis, levels, RADAR.waveform.range_step_m, RADAR.grid.u, pixels=(100, 90))
    ((row, column),) = np.argwhere(mesh.get_array() == 0.0)
    corners = np.asarray(mesh.get_coordinates())[row : row + 2, column : column + 2].reshape(4, 2)
    x, y = RANGE_M * np.sqrt(1 - U**2), RANGE_M * U
    assert corners[:, 0].min() <= y <= corners[:, 0].max()
    assert corners[:, 1].min() <= x <= corners[:, 1].max()
