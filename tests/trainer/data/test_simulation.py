"""Resting point targets: one chirp stands for the frame."""

import numpy as np
import pytest
from small_evaluation import RADAR

from shared.radar import load_radar
from shared.signal import if_signal
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import in_plane, snapshot, truth_image


def test_one_chirp_stands_for_the_frame_of_resting_targets():
    radar = load_radar("avr-qdm-110")
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"chirps": 8, "samples": 128,
                                                                                   "range_bins": 64})})  # fmt: skip
    positions = in_plane(np.array([3.03, 7.1]), np.array([0.2, -0.4]))
    amplitudes = np.array([1.0, 0.3j])
    cube = if_signal(radar, positions, np.zeros((2, 3)), amplitudes)
    expected = range_doppler(cube.astype(np.complex64), radar)[:, radar.waveform.chirps // 2]
    np.testing.assert_allclose(snapshot(radar, positions, amplitudes, None), expected, atol=2e-6)
    noise = snapshot(radar, positions[:0], amplitudes[:0], np.random.default_rng(1))
    # 64 x 48 cells, of which the range window leaves two thirds independent: a standard error of 2.2 %.
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(cell_noise_power(radar), rel=0.09)


def test_a_simulated_target_reads_its_amplitude_in_the_truth():
    row, column = 40, 12
    position = in_plane(np.array([row * RADAR.waveform.range_step_m]), np.array([RADAR.grid.u[column]]))
    truth = truth_image(RADAR, position, np.array([2e-6 + 0j]))
    assert np.unravel_index(truth.argmax(), truth.shape) == (row, column)
    assert truth.max() == pytest.approx(2e-6, rel=0.02)
