"""Radar files that are wrong: each is refused in one line that names the field and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest
from radar_files import CFG

from shared.physics.errors import InputError
from shared.radar import load_radar

MANY = [[0.0, 0.0, 0.0]] * 200
REFUSED = [
    ("[waveform]\nchirps = 0", "waveform.chirps = 0", "greater than or equal to 1"),
    ("[waveform]\nchirp = 5", "unknown field waveform.chirp"),
    ("[waveform]\nrange_bins = 5000", "range_bins = 5000", "at most samples = 1024"),
    ("[waveform]\ncarrier_hz = 'fast'", "waveform.carrier_hz = 'fast'"),
    ("[waveform]\nbandwidth_hz = inf", "waveform.bandwidth_hz = inf"),
    ("[waveform]\nmultiplexing = 'tdm'", "chirp_interval_s = 8.06e-05 leaves each of 3 TX", "0.0002418"),
    ("[grid]\nu_start = 0.5\nu_stop = 0.1", "u_stop = 0.1"),
    ("[array]\ntx_m = []\nrx_m = [[0, 0, 0]]", "array.tx_m = []"),
    ("[array]\ntx_m = [[0, 0]]\nrx_m = [[0, 0, 0]]", "array.tx_m.0"),
    ("[front_end.tx_pattern]\nkind = 'horn'", "front_end.tx_pattern", "horn"),
    ("waveform = 7", "waveform = 7"),
    ("[waveform", "not readable as TOML"),
    # The front end.
    ("[front_end]\ntx_polarization = 'X'", "front_end.tx_polarization = 'X'", "'V' or 'H'"),
    ("[front_end.converter]\nbits = 12", "front_end.converter.full_scale_dbm"),
    ("[front_end.converter]\nbits = 0\nfull_scale_dbm = 0", "front_end.converter.bits = 0"),
    ("[front_end.phase_noise]\nlevel_dbc_per_hz = nan", "front_end.phase_noise.level_dbc_per_hz = nan"),
    ("[front_end.phase_noise]\nlevel_dbc_per_hz = -40", "front_end.phase_noise leaves", "at most 0.3 rad"),
    ("[front_end]\ntx_polarization = 'H'\ntx_pattern = { kind = 'patch' }", "resonant_along = 'z'", "'y' with"),
    ("[front_end]\ntx_pattern = { kind = 'patch', file = 'p.csv' }", "front_end.tx_pattern: kind = 'patch'"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 'absent.csv' }", "absent.csv: not readable"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 3 }", "front_end.tx_pattern: file = 3"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 'p.csv', gain_dbi = 3 }", "unknown field gain_dbi"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 'p', outside_gain_dbi = 'x' }", "outside_gain_dbi = 'x'"),
    ("[front_end]\ntx_pattern = { kind = 'table' }", "front_end.tx_pattern.table.azimuth_deg"),
    ("[front_end]\ntx_pattern = { kind = 'patch', width_wavelengths = 0 }", "width_wavelengths = 0"),
    ("[front_end]\ntx_pattern = { kind = 'tr38901', gain_dbi = 3 }", "field front_end.tx_pattern.tr38901.gain_dbi"),
    # What no memory holds, with the figure.
    ("[grid]\nbins = 10000000", "grid.bins = 10000000; expected input should be less than or equal to 65536"),
    ("[waveform]\nchirps = 65536\nsamples = 1048576", "48 channels make a cube of 2.64e+04 GB; expected at most 2 GB"),
    ("[waveform]\nsamples = 40000\nrange_bins = 40000\nchirps = 1\n[grid]\nbins = 20000", "make an image of 3.2 GB"),
    ("[waveform]\nchirps = 1\nsamples = 20000\n[front_end]\nphase_noise = { level_dbc_per_hz = -100 }", "of 3.2 GB"),
    (f"[array]\ntx_m = {MANY}\nrx_m = {MANY}", "200 TX and 200 RX make 40000 channels; expected at most 16384"),
    # Boards.
    ("board = 'iwr9'", "board = 'iwr9'; expected one of ['iwr1443'"),
    ("board = 3", "board = 3; expected one of"),
    ("mirror = true", "mirror = true without a board"),
    ("board = 'iwr1843'\nmirror = 'yes'", "mirror = 'yes'; expected true or false"),
    ("board = 'iwr1843'\ncapture = 3", "capture = 3; expected a table"),
    ("board = 'iwr1843'\ncapture = 'none.cfg'", "none.cfg: not readable"),
    ("board = 'iwr1843'\n[capture]\nsamples = 3", "capture: start_frequency_hz"),
    ("board = 'iwr1843'\nwaveform = 3", "waveform"),
]


def refusal(path: Path, text: str) -> str:
    """The line, which begins with the file's folder or with what the file names."""
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_radar(str(path))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("text", "parts"), [(text, parts) for text, *parts in REFUSED])
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, parts: list[str]) -> None:
    line = refusal(tmp_path / "radar.toml", text)
    assert line.startswith(f"{tmp_path}/")
    assert [part for part in parts if part not in line] == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 1 1 0 0 0 0 0 6", "chirp 1 is sent by TX [2, 3]; expected one TX"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "", "frameCfg 0 1; expected chirps that a chirpCfg describes"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 0 1 0 0 0 0 0 1", "tx = [1, 1]; expected each TX once"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 1 1 0 0 0 0 0 8", "there is no 4; expected 1 to 3"),
        ("frameCfg 0 1 16", "frameCfg 0 x 16", "frameCfg: could not convert"),
        ("frameCfg 0 1 16", "frameCfg 0 1 nan", "at least 3 finite numbers"),
        ("60 0 0 20", "50 0 0 20", "samples end 5.5"),
        ("profileCfg 0", "profile 0", "0 lines profileCfg; expected exactly one"),
    ],
)
def test_a_wrong_cfg_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "profile.cfg").write_text(CFG.replace(old, new), encoding="utf-8")
    assert message in refusal(tmp_path / "radar.toml", "board = 'iwr1843'\ncapture = 'profile.cfg'")
