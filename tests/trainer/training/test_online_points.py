"""Online point targets: the signal model's echoes in both arrays, and the same crop for the same place."""

import numpy as np
import pytest
import torch
from tiny_radar import RADAR

from shared.radar import load_radar
from shared.signal import if_signal_of_delays
from shared.signal.windows import hann
from trainer.training.online_points import NEIGHBOURS, OnlinePoints, hann_response

CPU = torch.device("cpu")
QUIET = torch.zeros(1, 24, 6, dtype=torch.complex64)


def see(row, u, amplitude, noise=QUIET):
    points = OnlinePoints(RADAR, "none")
    return points._snapshots_and_truth(
        np.zeros(len(row), int), np.array(row), np.array(u), np.array(amplitude, complex), noise
    )


def test_the_range_response_is_the_spectrum_of_the_window():
    samples = 512
    window = hann(samples)
    offset = np.array([-2.7, -1.0, -0.4, 0.0, 0.25, 1.0, 1.5, 2.0])
    tone = np.exp(2j * np.pi * offset[:, None] * np.arange(samples) / samples)
    np.testing.assert_allclose(hann_response(offset), tone @ window / window.sum(), atol=2e-3)


def test_an_echo_is_that_of_the_signal_model_up_to_its_phase():
    """Eq. (1) and (2) at 60 m with the range FFT, against range bin and u alone: plane waves differ by little there."""
    radar = load_radar("avr-qdm-110")
    u, row = radar.grid.u[304], 400.3
    position = row * radar.waveform.range_step_m * np.array([np.sqrt(1 - u**2), u, 0.0])
    legs = [np.linalg.norm(part - position, axis=1) for part in (radar.array.tx, radar.array.rx)]
    tau = (legs[0][radar.array.channel_tx] + legs[1][radar.array.channel_rx]) / 299_792_458.0
    samples = if_signal_of_delays(radar, tau[:, None])[0]  # (N, C)
    window = hann(radar.waveform.samples)[:, None]
    spectrum = np.fft.fft(samples * window, axis=0)[398:404] / window.sum()
    points = OnlinePoints(radar, "taylor-30")
    noise = torch.zeros(1, 630, 48, dtype=torch.complex64)
    found = points._snapshots_and_truth(np.array([0]), np.array([row]), np.array([u]), np.array([1.0 + 0j]), noise)
    expected = found.range_channel[0, 398:404].numpy()
    projection = np.vdot(expected, spectrum) / np.vdot(expected, expected)
    assert abs(projection) == pytest.approx(1.0, abs=0.01)
    assert np.linalg.norm(spectrum - projection * expected) < 0.1 * np.linalg.norm(spectrum)
    # The truth reads the same amplitude at the same place.
    assert found.image_peak.item() == pytest.approx(abs(hann_response(np.array([0.3])))[0], rel=0.01)
    peak_row, peak_bin = np.unravel_index(int(found.image[0].argmax()), (630, 450))
    assert peak_row == 400
    assert radar.grid.u[peak_bin] == u


def test_echoes_add_and_a_row_outside_reaches_in():
    one, other = see([4.2], [0.1], [1.0]), see([5.1], [-0.3], [2j])
    both = see([4.2, 5.1], [0.1, -0.3], [1.0, 2j])
    torch.testing.assert_close(both.range_channel, one.range_channel + other.range_channel)
    outside = see([-0.5], [0.0], [1.0])
    assert outside.range_channel[0, 0].abs().min() > 0.5
    beyond = abs(hann_response(np.arange(NEIGHBOURS[-1] + 0.5, 20.0)))
    assert 20 * np.log10(beyond.max()) < -48.0


def test_a_crop_is_a_function_of_seed_step_and_place_alone():
    points = OnlinePoints(RADAR, "none")
    whole = points(1, 7, range(4), 24, CPU)
    part = points(1, 7, range(2, 4), 24, CPU)
    assert torch.equal(whole.range_channel[2:], part.range_channel)
    assert torch.equal(whole.image[2:], part.image)
    for other in (points(2, 7, range(4), 24, CPU), points(1, 8, range(4), 24, CPU)):
        assert not torch.equal(whole.range_channel, other.range_channel)
    assert whole.image.shape == (4, 24, 20)
    assert whole.image.amax(dim=(1, 2)).max() == 1.0
    assert whole.image_peak.dtype == torch.float64


def test_noise_has_unit_power_and_the_truth_none(monkeypatch):
    monkeypatch.setattr("trainer.training.online_points.TARGETS_PER_ROW", (1e-9, 2e-9))
    crops = OnlinePoints(RADAR, "none")(0, 0, range(40), 24, CPU)
    assert crops.range_channel.abs().square().mean().item() == pytest.approx(1.0, abs=0.05)
    assert not crops.image.any()
    assert crops.image_peak.tolist() == [1.0] * 40
