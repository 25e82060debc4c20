"""What the simulated experiments look at: resting targets, and pairs that are what they say."""

import numpy as np
import pytest
from paper_arrays import FAR
from small_evaluation import FULL, RADAR

from shared.radar import load_radar
from shared.signal import if_signal
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import SPACING_BINS, TrialCondition, in_plane, simulate, snapshot, truth_image
from trainer.estimators.array import line_array


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
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(cell_noise_power(radar), rel=0.09, abs=0.0)


def test_a_simulated_target_reads_its_amplitude_in_the_truth():
    row, column = 40, 12
    position = in_plane(np.array([row * RADAR.waveform.range_step_m]), np.array([RADAR.grid.u[column]]))
    truth = truth_image(RADAR, position, np.array([2e-6 + 0j]))
    assert np.unravel_index(truth.argmax(), truth.shape) == (row, column)
    assert truth.max() == pytest.approx(2e-6, rel=0.02)


def test_trials_have_the_separation_the_ratio_and_the_noise_that_they_say():
    condition = TrialCondition(separation_cells=2.0, snr_db=200.0, ratio_db=6.0)
    trials = simulate(RADAR, condition, 5, [0])
    images, rows, channels = trials.snapshots.shape
    assert (rows, channels) == (48, 6)
    assert len(trials.u) == images * len(trials.rows) >= 5
    assert np.ptp(trials.phase_rad) > 1.0
    line = line_array(RADAR, FULL.channels(RADAR))
    np.testing.assert_allclose(np.diff(trials.u, axis=1), 2.0 * line.resolution_cell)
    middle = 0.5 * (line.positions_m.min() + line.positions_m.max())
    flat = trials.snapshots[:, trials.rows].reshape(len(trials.u), -1)
    for x, u, phase in zip(flat, trials.u, trials.phase_rad, strict=True):
        amplitude = np.linalg.lstsq(line.manifold(u), x, rcond=None)[0]
        ratio_db = 20.0 * np.log10(np.abs(amplitude))
        assert abs(ratio_db[1] - ratio_db[0]) == pytest.approx(6.0, abs=0.3)
        turned = amplitude * np.exp(-2j * np.pi / line.wavelength_m * middle * u)  # phases at the array's middle
        assert np.angle(turned[1] / turned[0] * np.exp(-1j * phase)) == pytest.approx(0.0, abs=0.1)


def test_noise_and_amplitude_are_those_of_the_ratio_that_they_say() -> None:
    radar = FAR
    loud, quiet = (simulate(radar, TrialCondition(0.0, snr), 200, [4]) for snr in (30.0, 10.0))
    np.testing.assert_array_equal(loud.u, quiet.u)
    power = cell_noise_power(radar)
    line = line_array(radar)
    for trials, snr in ((loud, 1e3), (quiet, 10.0)):
        empty = trials.snapshots[:, trials.rows - SPACING_BINS // 2]
        assert np.mean(np.abs(empty) ** 2) == pytest.approx(power, rel=0.05, abs=0.0)
        rows = trials.snapshots[:, trials.rows].reshape(len(trials.u), -1)
        matched = np.abs(np.einsum("ct,tc->t", line.manifold(trials.u[:, 0]).conj(), rows)) ** 2 / line.channels**2
        assert np.mean(matched) == pytest.approx(power * (snr + 1.0 / line.channels), rel=0.05, abs=0.0)


def test_the_same_seed_draws_the_same_trials() -> None:
    condition = TrialCondition(1.0, 20.0, 10.0)
    one, again, other = (simulate(RADAR, condition, 5, [seed]) for seed in (9, 9, 10))
    np.testing.assert_array_equal(one.snapshots, again.snapshots)
    np.testing.assert_array_equal(one.phase_rad, again.phase_rad)
    assert not np.array_equal(one.u, other.u)
