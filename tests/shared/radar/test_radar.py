"""The radar as a description: array, waveform, axes, presets, TOML, metadata."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from shared.physics.errors import InputError
from shared.processes.defaults import DEFAULT_RADAR
from shared.radar import PRESETS, FrontEnd, Radar, load_radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AVR_QDM_110_THINNED_RX, AntennaArray, avr_qdm_110, virtual_sensor_256
from shared.radar.waveform import Waveform


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
    # Waveform and front end come back from the metadata alone.
    again = Waveform(**{field: document["radar"][field] for field in Waveform.model_fields})
    assert again == radar.waveform
    assert FrontEnd(**{field: document["radar"][field] for field in FrontEnd.model_fields}) == radar.front_end


def test_the_virtual_sensor_follows_the_carrier(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text("[waveform]\ncarrier_hz = 60e9\n", encoding="utf-8")
    radar = load_radar(str(path))
    assert radar.virtual_sensor == virtual_sensor_256(60e9)


def test_a_toml_file_states_what_differs(tmp_path):
    path = tmp_path / "my-radar.toml"
    path.write_text(
        '[waveform]\nchirps = 64\nmultiplexing = "tdm"\n[front_end]\nnoise_figure_db = 9.5\n'
        '[front_end.rx_pattern]\nkind = "isotropic"\ngain_dbi = 2\n[grid]\nbins = 100\n'
        "[array]\ntx_m = [[0, 0, 0]]\nrx_m = [[0, 0.01, 0], [0, 0.02, 0]]\n",
        encoding="utf-8",
    )
    radar = load_radar(str(path))
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
