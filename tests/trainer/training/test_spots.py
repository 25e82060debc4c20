"""Spots: where they stand, how wide they are, what they are made of in scenes."""

import numpy as np
import torch
from tiny_radar import NOISE_POWER, RADAR, frame

from trainer.metrics.cells import truth_cells
from trainer.training.losses import SIGMA_BINS, SIGMA_ROWS, scene_spots, spots

ROWS, BINS = 12, 20


def test_a_spot_is_its_equation_written_out():
    row, place = np.array([4.3, 9.0]), np.array([11.7, 3.0])
    image = spots(ROWS, BINS, row, place)
    assert image.dtype == np.float32
    for r in range(ROWS):
        for b in range(BINS):
            expected = np.exp(-0.5 * ((r - row) / SIGMA_ROWS) ** 2 - 0.5 * ((b - place) / SIGMA_BINS) ** 2).max()
            # What lies farther away than a spot reaches is left out.
            assert abs(image[r, b] - expected) < 0.01 or (image[r, b] == 0.0 and expected < 0.14)
    assert image[9, 3] == 1.0


def test_targets_three_bins_apart_are_two_maxima_and_two_at_one_place_are_one_spot():
    row = np.array([5.0, 5.0])
    line = spots(ROWS, BINS, row, np.array([8.0, 11.0]))[5]
    assert line[8] == line[11] == 1.0
    assert line[9:11].max() < 0.5
    np.testing.assert_array_equal(spots(ROWS, BINS, row, np.array([8.0, 8.0])), spots(ROWS, BINS, row[:1], row[:1] + 3))


def test_a_target_at_the_edge_or_outside_leaves_the_rest_of_its_spot():
    image = spots(ROWS, BINS, np.array([-0.4, 3.0, 50.0]), np.array([0.0, BINS + 0.4, 3.0]))
    assert image[0, 0] > 0.5
    assert 0.1 < image[3, BINS - 1] < 0.5
    assert not image[5:].any()
    assert not spots(ROWS, BINS, np.empty(0), np.empty(0)).any()


def test_the_spots_of_a_scene_stand_on_the_cells_of_its_truth():
    made = frame(0)
    given = torch.from_numpy(made.image)[None], torch.tensor([made.image_peak]), torch.tensor([NOISE_POWER])
    image = scene_spots(*given, 6, RADAR)
    cells = truth_cells(made.image * made.image_peak, NOISE_POWER, 6, RADAR.waveform.range_step_m)
    assert image.shape == (1, *made.image.shape)
    assert np.argwhere(image[0].numpy() == 1.0).tolist() == cells.tolist()
    loud = scene_spots(given[0], given[1], given[2] * 1e20, 6, RADAR)
    assert not loud.any()
