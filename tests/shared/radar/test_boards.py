"""Boards and chirps as TI states them: geometry, the sweep that is sampled, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from radar_files import CFG

from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar, load_capture_radar, load_radar
from shared.radar.boards import BOARDS
from shared.signal.signal import if_signal


def file(folder: Path, text: str, name: str = "radar.toml") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


@pytest.mark.parametrize(
    ("name", "channels", "on_line", "places"),
    [
        ("iwr1443", 12, 8, 8),
        ("iwr1642", 8, 8, 8),
        ("iwr1843", 12, 8, 8),
        ("awr2944", 16, 12, 12),
        ("mmwcas", 192, 144, 86),
        ("mmwcas-azimuth", 144, 144, 86),
    ],
)
def test_the_azimuth_line_is_gapless_at_half_a_wavelength(name: str, channels: int, on_line: int, places: int) -> None:
    """As published; elevated channels stay in the array and are no part of the line."""
    array = load_radar(name).array
    assert (array.channels, len(array.azimuth_channels)) == (channels, on_line)
    line = np.unique(np.round(array.virtual[array.azimuth_channels, 1] * 1e7))
    assert len(line) == places
    half_wavelength = SPEED_OF_LIGHT / 2.0 / (76.8e9 if "mmwcas" in name else 77e9)
    np.testing.assert_allclose(np.diff(line) * 1e-7, half_wavelength, atol=2e-7)
    np.testing.assert_allclose(array.rx.mean(axis=0), 0.0, atol=1e-12)  # the origin


@pytest.mark.parametrize("name", BOARDS)
def test_a_board_takes_turns_within_its_intervals(name: str) -> None:
    waveform = load_radar(name).waveform
    assert waveform.multiplexing == "tdm"
    assert waveform.chirp_duration_s < waveform.chirp_interval_s / len(load_radar(name).array.tx_m)


def test_a_target_on_the_left_leads_the_channels_in_the_order_of_their_numbers() -> None:
    """y falls with the number: from the left, the path to the first RX is the shortest, and its phase the least."""
    radar = load_radar("iwr1642")
    left = np.array([[10.0 * np.cos(0.1), 10.0 * np.sin(0.1), 0.0]])
    chirp = if_signal(radar, left, np.zeros((1, 3)), np.ones(1))[0, 128]
    rx_of_tx1 = chirp[radar.array.channel_tx == 0]
    steps = np.angle(rx_of_tx1[1:] * rx_of_tx1[:-1].conj())
    np.testing.assert_allclose(steps, np.pi * np.sin(0.1) * radar.waveform.mid_sweep_hz / 77e9, rtol=0.01)


def test_a_mirrored_board_sees_the_other_side(tmp_path: Path) -> None:
    plain, turned = load_radar("iwr1843"), load_radar(file(tmp_path, 'board = "iwr1843"\nmirror = true\n'))
    np.testing.assert_array_equal(turned.array.virtual, plain.array.virtual * [1.0, -1.0, 1.0])
    assert turned.front_end == plain.front_end
    again = load_capture_radar(str(tmp_path / "radar.toml"), "iwr1843", mirror=True).radar
    np.testing.assert_array_equal(again.array.virtual, plain.array.virtual)


def test_sampling_that_begins_late_raises_the_carrier(tmp_path: Path) -> None:
    text = (
        'board = "iwr1843"\n[capture]\nstart_frequency_hz = 77e9\nslope_hz_per_s = 30e12\nidle_time_s = 10e-6\n'
        "adc_start_time_s = 7e-6\nramp_end_time_s = 60e-6\nsamples = 200\nsample_rate_hz = 4e6\nchirps = 32\n"
        "tx = [3, 1]\nrx = [1, 2, 4]\n[front_end]\nnoise_figure_db = 11.0\n"
    )
    radar, board = load_radar(file(tmp_path, text)), load_radar("iwr1843")
    waveform = radar.waveform
    assert waveform.carrier_hz == pytest.approx(77e9 + 30e12 * 7e-6)
    assert waveform.bandwidth_hz == pytest.approx(30e12 * 50e-6)
    assert waveform.chirp_interval_s == pytest.approx(2 * 70e-6)
    assert (waveform.chirps, waveform.samples, waveform.range_bins) == (32, 200, 200)
    assert radar.array.tx_m == (board.array.tx_m[2], board.array.tx_m[0])
    assert radar.array.rx_m == tuple(board.array.rx_m[rx] for rx in (0, 1, 3))
    assert (radar.front_end.noise_figure_db, radar.front_end.rx_pattern) == (11.0, board.front_end.rx_pattern)
    assert Radar.model_validate_json(radar.model_dump_json()) == radar


def test_a_cfg_of_the_sdk_states_the_chirps(tmp_path: Path) -> None:
    file(tmp_path, CFG, "profile.cfg")
    radar = load_radar(file(tmp_path, 'board = "iwr1843"\ncapture = "profile.cfg"\n'))
    waveform, board = radar.waveform, load_radar("iwr1843")
    assert waveform.carrier_hz == pytest.approx(77.12e9)
    assert waveform.bandwidth_hz == pytest.approx(20e12 * 256 / 5209e3)
    assert (waveform.samples, waveform.chirps) == (256, 16)
    assert radar.array.tx_m == (board.array.tx_m[0], board.array.tx_m[2])


def test_real_samples_have_half_the_range_bins() -> None:
    waveform = load_radar("awr2944").waveform
    assert waveform.range_bins == waveform.samples // 2
