"""Radar files: what stands for what they do not state, and chirps that need a board or elements."""

from pathlib import Path

import numpy as np
import pytest
from raw_files import CFG, CHIRPS
from small_radar import refusal, write_radar

from shared.radar import load_capture_radar, load_radar


@pytest.mark.parametrize(
    ("line", "told"),
    [("", None), ("adcbufCfg -1 0 1 1 1", True), ("adcbufCfg 0 1 0 1", True), ("adcbufCfg -1 0 0 1 1", False)],
)
def test_a_cfg_says_whether_q_comes_first(tmp_path: Path, line: str, told: bool | None) -> None:
    """SampleSwap, the third number, or the second where the demo has no subframes."""
    path = write_radar(tmp_path, CFG + line, "profile.cfg")
    assert load_capture_radar(path, "iwr1843").quadrature_first is told


def test_chirps_without_elements_are_refused(tmp_path: Path) -> None:
    """They were those of the default radar, whose channels are others."""
    chirps = f"[capture]\n{CHIRPS}"
    expected = 'radar.toml: capture without a board; expected board = "NAME" beside it, or a table [array]'
    assert expected in refusal(tmp_path, chirps)
    expected = 'profile.cfg: capture without a board; expected a radar file with board = "NAME" and capture = "profile'
    assert expected in refusal(tmp_path, CFG, "profile.cfg")
    assert load_capture_radar(str(tmp_path / "radar.toml"), "iwr1843").radar.array == load_radar("iwr1843").array


def test_samples_are_real_where_those_of_the_board_are(tmp_path: Path) -> None:
    """Without the line ``real`` they were taken to be complex."""
    chirps = f"board = 'awr2944'\n[capture]\n{CHIRPS}"
    found = load_capture_radar(write_radar(tmp_path, chirps), None)
    assert (found.real, found.radar.waveform.range_bins) == (True, found.radar.waveform.samples // 2)
    assert not load_capture_radar(write_radar(tmp_path, chirps), "iwr1843").real
    assert load_capture_radar(write_radar(tmp_path, chirps + "real = true"), "iwr1843").real
    path = tmp_path / "radar.toml"
    expected = "capture.real = False; expected true, or no such line: board 'awr2944' records no Q"
    assert expected in refusal(tmp_path, chirps + "real = false")
    write_radar(tmp_path, CFG, "profile.cfg")
    expected = "profile.cfg: adcCfg asks for complex samples; expected adcCfg 2 0: board 'awr2944' records no Q"
    assert expected in refusal(tmp_path, "board = 'awr2944'\ncapture = 'profile.cfg'")
    write_radar(tmp_path, CFG.replace("adcCfg 2 1", ""), "profile.cfg")
    assert load_capture_radar(str(path), None).real


def test_an_array_of_ones_own_is_mirrored_too(tmp_path: Path) -> None:
    own = f"[array]\ntx_m = [[0, 0.001, 0]]\nrx_m = [[0, 0, 0], [0, 0.002, 0]]\n[capture]\n{CHIRPS}"
    plain = load_capture_radar(write_radar(tmp_path, own), "iwr1843").radar.array
    turned = [
        load_capture_radar(write_radar(tmp_path, own), "iwr1843", mirror=True).radar.array,
        load_radar(write_radar(tmp_path, f"mirror = true\n{own}")).array,
    ]
    for array in turned:
        np.testing.assert_array_equal(array.virtual, plain.virtual * [1.0, -1.0, 1.0])
    assert load_capture_radar(str(tmp_path / "radar.toml"), "iwr1843", mirror=True).radar.array == plain


@pytest.mark.parametrize(
    ("text", "bins"),
    [
        ("board = 'iwr1843'\n[waveform]\nsamples = 128", 128),
        ("board = 'iwr1843'\n[waveform]\nsamples = 512", 256),
        ("board = 'awr2944'\n[waveform]\nsamples = 128", 64),
        ("board = 'awr2944'\n[waveform]\nsamples = 128\nrange_bins = 100", 100),
        ("[waveform]\nsamples = 256", 256),
        ("[waveform]\nsamples = 2048", 630),
    ],
)
def test_range_bins_that_are_not_stated_are_no_more_than_the_samples(tmp_path: Path, text: str, bins: int) -> None:
    """Of real samples, no more than half of them."""
    assert load_radar(write_radar(tmp_path, text)).waveform.range_bins == bins


def test_a_file_may_begin_with_the_mark_of_its_encoding(tmp_path: Path) -> None:
    assert load_radar(write_radar(tmp_path, "\ufeffboard = 'iwr1843'\n")).array == load_radar("iwr1843").array
