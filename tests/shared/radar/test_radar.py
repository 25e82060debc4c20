"""The radar as a description: array, waveform, axes, presets, boards, TOML, metadata; and files that are wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from raw_files import CFG
from small_radar import refusal, write_radar

from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT
from shared.processes.defaults import DEFAULT_RADAR
from shared.radar import PRESETS, Radar, load_capture_radar, load_radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AVR_QDM_110_THINNED_RX, AntennaArray, avr_qdm_110, virtual_sensor_256
from shared.radar.boards import BOARDS
from shared.radar.waveform import Waveform
from shared.signal.signal import if_signal


def test_published_coordinates_move_to_the_centroid_of_the_receivers():
    array = avr_qdm_110()
    np.testing.assert_allclose(array.rx.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(array.tx[:, 1] + 45e-3, [-5e-3, -3e-3, -1e-3])
    np.testing.assert_allclose(array.rx[:, 1] + 45e-3, 6e-3 * np.arange(16), atol=1e-15)


def test_48_virtual_elements_stand_2_mm_apart_in_rx_major_order():
    array = avr_qdm_110()
    assert array.channels == 48
    np.testing.assert_allclose(np.diff(array.virtual[:, 1]), 2e-3)
    assert array.channel_tx[:4].tolist() == [0, 1, 2, 0]
    assert array.channel_rx[:4].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(("name", "channels"), [("full", 48), ("sparse6", 18), ("sparse4", 12)])
def test_thinned_arrays_keep_whole_receivers_and_the_aperture(name, channels):
    array = avr_qdm_110()
    indices = array.channel_indices(AVR_QDM_110_THINNED_RX[name])
    assert len(indices) == channels
    assert set(array.channel_rx[indices]) == set(AVR_QDM_110_THINNED_RX[name])
    assert np.ptp(array.virtual[indices, 1]) == pytest.approx(94e-3)


def test_an_unknown_receiver_is_refused():
    with pytest.raises(ValueError, match=r"RX \[16\] do not exist; expected indices from 0 to 15"):
        avr_qdm_110().channel_indices((0, 16))


def test_an_array_in_millimetres_is_refused():
    with pytest.raises(ValidationError, match="90 m from the origin; expected metres"):
        AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 90.0, 0.0),))


def test_axes_of_the_default_radar():
    radar = Radar()
    waveform = radar.waveform
    assert (len(waveform.ranges_m), len(waveform.velocities_mps), len(radar.grid.u)) == (630, 128, 450)
    assert waveform.range_step_m == pytest.approx(0.149896229)
    assert waveform.ranges_m[-1] == pytest.approx(94.28, abs=0.01)
    assert waveform.unambiguous_range_m == pytest.approx(1024 * 0.149896229)
    # lambda / (2 M T) at mid-sweep; the lower edge is in the axis, the upper is not.
    assert waveform.velocity_step_mps == pytest.approx(299_792_458.0 / 77.5e9 / 2.0 / (128 * 80.6e-6))
    assert waveform.velocities_mps[64] == 0.0
    assert waveform.velocities_mps[0] == pytest.approx(-299_792_458.0 / 77.5e9 / 4.0 / 80.6e-6)
    np.testing.assert_allclose(radar.grid.u, -0.85 + 1.7 * np.arange(450) / 450)
    assert waveform.slope_hz_per_s * waveform.chirp_duration_s == pytest.approx(1e9)


def test_one_chirp_tells_no_velocity():
    told = str(Radar().of_one_chirp)
    assert "1 chirp of 1024 samples" in told
    assert "velocity: one chirp tells none" in told
    assert "128 chirps of" in str(Radar())
    assert "velocity: +-12 m/s in steps of 0.187 m/s" in str(Radar())


def test_velocity_axis_of_an_odd_number_of_chirps():
    velocities = Waveform(chirps=5).velocities_mps
    np.testing.assert_allclose(velocities, -velocities[::-1])


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_json(name):
    radar = load_radar(name)
    assert radar.name == name
    assert Radar.model_validate_json(radar.model_dump_json()) == radar


def test_metadata_is_json_and_holds_the_axes():
    radar = load_radar(DEFAULT_RADAR)
    document = json.loads(json.dumps(radar.metadata(), allow_nan=False))
    assert document["array"]["rx_m"][15][1] == pytest.approx(0.045)
    assert len(document["virtual_sensor"]["rx_m"]) == 256
    for axis, values in (("range_m", radar.waveform.ranges_m), ("velocity_mps", radar.waveform.velocities_mps)):
        stated = document["axes"][axis]
        np.testing.assert_allclose(stated["start"] + stated["step"] * np.arange(stated["bins"]), values, atol=1e-9)
    edges = document["axes"]["velocity_mps"]
    assert edges["stop"] == pytest.approx(-edges["start"])
    stated = document["axes"]["u"]
    np.testing.assert_allclose(stated["start"] + stated["step"] * np.arange(stated["bins"]), radar.grid.u)


def test_the_virtual_sensor_follows_the_carrier(tmp_path):
    radar = load_radar(write_radar(tmp_path, "[waveform]\ncarrier_hz = 60e9\n"))
    assert radar.virtual_sensor == virtual_sensor_256(60e9)


def test_a_toml_file_states_what_differs(tmp_path):
    text = (
        '[waveform]\nchirps = 64\nmultiplexing = "tdm"\n[front_end]\nnoise_figure_db = 9.5\n'
        '[front_end.rx_pattern]\nkind = "isotropic"\ngain_dbi = 2\n[grid]\nbins = 100\n'
        "[array]\ntx_m = [[0, 0, 0]]\nrx_m = [[0, 0.01, 0], [0, 0.02, 0]]\n"
    )
    radar = load_radar(write_radar(tmp_path, text, "my-radar.toml"))
    assert (radar.name, radar.waveform.chirps, radar.waveform.multiplexing) == ("my-radar", 64, "tdm")
    assert radar.waveform.samples == Waveform().samples
    assert radar.front_end.noise_figure_db == 9.5
    assert radar.front_end.rx_pattern == IsotropicPattern(gain_dbi=2.0)
    assert radar.array.channels == 2
    assert len(radar.grid.u) == 100


def test_an_unknown_preset_names_the_known_ones(tmp_path):
    with pytest.raises(InputError, match=r"no preset and no file 'avr'; expected a TOML file or one of .*avr-qdm-110"):
        load_radar("avr")
    with pytest.raises(InputError, match="no preset and no file"):
        load_radar(str(tmp_path))


def test_virtual_sensor():
    array = virtual_sensor_256(77e9)
    half_wavelength = 299_792_458.0 / 77e9 / 2.0
    np.testing.assert_allclose(array.rx[:, 1], (np.arange(256) - 127.5) * half_wavelength, rtol=1e-12)
    np.testing.assert_array_equal(array.tx, np.zeros((1, 3)))


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


def test_the_azimuth_line_is_that_of_most_channels_where_tx_stand_above_rx() -> None:
    """Two TX 10 mm above four RX, and a third 2 mm higher still, whose channels see the elevation too."""
    tx = ((0.0, 0.0, 0.01), (0.0, 0.004, 0.012), (0.0, 0.008, 0.01))
    array = AntennaArray(tx_m=tx, rx_m=tuple((0.0, 0.002 * number, 0.0) for number in range(4)))
    assert array.channel_tx[array.azimuth_channels].tolist() == [0, 2] * 4


@pytest.mark.parametrize(("tx", "interval_s", "tx_m"), [("", 134e-6, (0.0, 0.004)), ("tx = [2]", 67e-6, (0.004,))])
def test_the_tx_of_an_own_array_take_the_turns_of_its_capture(tmp_path: Path, tx: str, interval_s: float, tx_m) -> None:
    """Worked out by hand: 7 us idle and a ramp of 60 us for each TX, where the default radar has three."""
    text = (
        "[array]\ntx_m = [[0, 0, 0], [0, 0.004, 0]]\nrx_m = [[0, 0, 0], [0, 0.002, 0]]\n[capture]\n"
        "start_frequency_hz = 77e9\nslope_hz_per_s = 3e13\nidle_time_s = 7e-6\nramp_end_time_s = 60e-6\n"
        f"samples = 128\nsample_rate_hz = 4e6\nchirps = 16\n{tx}\n"
    )
    radar = load_radar(write_radar(tmp_path, text))
    assert radar.waveform.chirp_interval_s == pytest.approx(interval_s, rel=1e-12)
    assert [y for _, y, _ in radar.array.tx_m] == list(tx_m)


def test_a_mirrored_board_sees_the_other_side(tmp_path: Path) -> None:
    plain, turned = load_radar("iwr1843"), load_radar(write_radar(tmp_path, 'board = "iwr1843"\nmirror = true\n'))
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
    radar, board = load_radar(write_radar(tmp_path, text)), load_radar("iwr1843")
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
    write_radar(tmp_path, CFG, "profile.cfg")
    radar = load_radar(write_radar(tmp_path, 'board = "iwr1843"\ncapture = "profile.cfg"\n'))
    waveform, board = radar.waveform, load_radar("iwr1843")
    assert waveform.carrier_hz == pytest.approx(77.12e9)
    assert waveform.bandwidth_hz == pytest.approx(20e12 * 256 / 5209e3)
    assert (waveform.samples, waveform.chirps) == (256, 16)
    assert radar.array.tx_m == (board.array.tx_m[0], board.array.tx_m[2])


def test_real_samples_have_half_the_range_bins() -> None:
    waveform = load_radar("awr2944").waveform
    assert waveform.range_bins == waveform.samples // 2


MANY = [[0.0, 0.0, 0.0]] * 200
REFUSED = [
    ("[waveform]\nchirps = 0", "waveform.chirps = 0; expected at least 1"),
    ("[waveform]\nchirp = 5", "unknown field waveform.chirp; expected one of carrier_hz, ", "; did you mean 'chirps'?"),
    ("[waveforms]", "unknown field waveforms; expected one of name, ", "mirror, capture; did you mean 'waveform'?"),
    ("[waveform]\nchirps = '4'", "waveform.chirps = '4'; expected a whole number"),
    ("[waveform]\nchirps = true", "waveform.chirps = True; expected a whole number"),
    ("[waveform]\nchirps = 4.5", "waveform.chirps = 4.5; expected a whole number"),
    ("[waveform]\ncarrier_hz = 77", "waveform.carrier_hz = 77.0 makes the virtual_sensor", "at least 19.2e9"),
    ("[front_end]\nnoise_figure_db = '4'", "front_end.noise_figure_db = '4'; expected a number"),
    ("[front_end.tx_pattern]\nkind = 'patch'\nback = 3", "unknown field front_end.tx_pattern.patch.back", "'back_db'?"),
    ("[front_end.tx_pattern]\ngain_dbi = 3", "front_end.tx_pattern = {'gain_dbi': 3}; expected an entry 'kind'"),
    ("[waveform]\nrange_bins = 5000", "range_bins = 5000", "at most samples = 1024"),
    ("[waveform]\nbandwidth_hz = inf", "waveform.bandwidth_hz = inf"),
    ("[waveform]\nmultiplexing = 'tdm'", "chirp_interval_s = 8.06e-05 leaves each of 3 TX", "0.0002418"),
    ("[grid]\nu_start = 0.5\nu_stop = 0.1", "u_stop = 0.1"),
    ("[array]\ntx_m = []\nrx_m = [[0, 0, 0]]", "array.tx_m = []; expected 1 or more entries"),
    ("[front_end.tx_pattern]\nkind = 'horn'", "front_end.tx_pattern", "horn"),
    ("[waveform", "not readable as TOML"),
    # The front end.
    ("[front_end]\ntx_polarization = 'X'", "front_end.tx_polarization = 'X'", "'V' or 'H'"),
    ("[front_end.converter]\nbits = 0\nfull_scale_dbm = 0", "front_end.converter.bits = 0"),
    ("[front_end.phase_noise]\nlevel_dbc_per_hz = -40", "front_end.phase_noise leaves", "at most 0.3 rad"),
    ("[front_end]\ntx_polarization = 'H'\ntx_pattern = { kind = 'patch' }", "resonant_along = 'z'", "'y' with"),
    ("[front_end]\ntx_pattern = { kind = 'patch', file = 'p.csv' }", "front_end.tx_pattern: kind = 'patch'"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 'absent.csv' }", "absent.csv: not readable"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 3 }", "front_end.tx_pattern: file = 3"),
    ("[front_end]\ntx_pattern = { kind = 'table', file = 'p.csv', gain_dbi = 3 }", "unknown field gain_dbi"),
    ("[front_end]\ntx_pattern = { kind = 'table' }", "front_end.tx_pattern.table.azimuth_deg"),
    # What no memory holds, with the figure.
    ("[grid]\nbins = 10000000", "grid.bins = 10000000; expected at most 65536"),
    ("[waveform]\nchirps = 65536\nsamples = 1048576", "48 channels make a cube of 2.64e+04 GB; expected at most 2 GB"),
    ("[waveform]\nsamples = 40000\nrange_bins = 40000\nchirps = 1\n[grid]\nbins = 20000", "make an image of 3.2 GB"),
    ("[waveform]\nchirps = 1\nsamples = 20000\n[front_end]\nphase_noise = { level_dbc_per_hz = -100 }", "of 3.2 GB"),
    (f"[array]\ntx_m = {MANY}\nrx_m = {MANY}", "200 TX and 200 RX make 40000 channels; expected at most 16384"),
    ("[virtual_sensor]\ntx_m = [[0, 0, 0], [0, 1, 0]]\nrx_m = [[0, 0, 0]]", "virtual_sensor.tx_m has 2 TX; expected 1"),
    ("[virtual_sensor]\ntx_m = [[0, 0, 0]]\nrx_m = [[0, 0, 0], [0, 0.004, 0], [0, 0.002, 0]]", "neighbours 1.03 wave"),
    # Boards.
    ("board = 'iwr9'", "board = 'iwr9'; expected one of ['iwr1443'"),
    ("board = 3", "board = 3; expected one of"),
    ("mirror = true", "mirror = true without a board"),
    ("board = 'iwr1843'\nmirror = 'yes'", "mirror = 'yes'; expected true or false"),
    ("board = 'iwr1843'\ncapture = 3", "capture = 3; expected a table"),
    ("board = 'iwr1843'\ncapture = 'none.cfg'", "none.cfg: not readable"),
    ("board = 'iwr1843'\n[capture]\nsamples = 3", "capture: start_frequency_hz missing; expected a value"),
    ("[capture]\nchirp = 3\nchirps = 3\nsamples = 9\nsample_rate_hz = 4e6\nramp_end_time_s = 6e-5\n"
     "slope_hz_per_s = 3e13\nstart_frequency_hz = 77e9", "capture: unknown field chirp; expected one of start_"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "parts"), [(text, parts) for text, *parts in REFUSED])
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, parts: list[str]) -> None:
    line = refusal(tmp_path, text)
    assert line.startswith(f"{tmp_path}/")
    assert [part for part in parts if part not in line] == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 1 1 0 0 0 0 0 6", "chirp 1 is sent by TX [2, 3]; expected one TX"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "", "frameCfg 0 1; expected chirps that a chirpCfg describes"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 0 1 0 0 0 0 0 1", "tx = [1, 1]; expected each TX once"),
        (
            "chirpCfg 1 1 0 0 0 0 0 4",
            "chirpCfg 1 1 0 0 0 0 0 8",
            "chirp 1 is sent by TX 4; expected one of TX [1, 3], w",
        ),
        ("channelCfg 15 5 0", "channelCfg 31 5 0", "rx = [1, 2, 3, 4, 5]: there is no 5; expected 1 to 4"),
        ("channelCfg 15 5 0", "channelCfg 15 1 0", "chirp 1 is sent by TX 3; expected one of TX [1], which channelCfg"),
        ("adcCfg 2 1", "adcCfg 2 1\nadcbufCfg -1 0 2 1 1", "adcbufCfg: SampleSwap = 2; expected 0 where I comes first"),
        ("adcCfg 2 1", "adcCfg 2 1\nadcbufCfg -1 0 1", "adcbufCfg -1 0 1; expected at least 4 finite numbers"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 1 1 0 0 0 50 0 4", "0 50 0 4; expected profile 0 and variations of 0"),
        ("chirpCfg 1 1 0 0 0 0 0 4", "chirpCfg 1 1 1 0 0 0 0 4", "chirpCfg 1 1 1 0 0 0 0 4; expected profile 0 and"),
        ("frameCfg 0 1 16", "frameCfg 0 x 16", "frameCfg: could not convert"),
        ("frameCfg 0 1 16", "frameCfg 0 1 nan", "at least 3 finite numbers"),
        ("60 0 0 20", "50 0 0 20", "samples end 5.5"),
        ("profileCfg 0", "profile 0", "0 lines profileCfg; expected exactly one"),
    ],
)
def test_a_wrong_cfg_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "profile.cfg").write_text(CFG.replace(old, new), encoding="utf-8")
    assert message in refusal(tmp_path, "board = 'iwr1843'\ncapture = 'profile.cfg'")


def test_what_a_radar_does_not_allow_together_is_refused_where_it_is_built() -> None:
    with pytest.raises(ValidationError, match="at least 3 x chirp_duration_s = "):
        Radar(waveform=Waveform(multiplexing="tdm"))
    with pytest.raises(ValidationError, match="expected 1, which lights the truth"):
        Radar(virtual_sensor=load_radar("iwr1443").array)
