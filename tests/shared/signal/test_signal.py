"""Eq. (1)-(2) as a signal: absolute level, signs, reciprocity, noise."""

from __future__ import annotations

import json

import numpy as np
import pytest
from oracles import if_cube, receiver_noise, reference_file, relative_error

from datafactory.paths.table import PathTable, ScatteredPaths
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal import if_signal, target_amplitudes
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power

PAIR = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))


@pytest.mark.parametrize("multiplexing", ["simultaneous", "tdm"])
@pytest.mark.parametrize("video_phase", [False, True])
def test_the_sum_is_equation_1(small_radar, generator, multiplexing, video_phase):
    radar = small_radar(samples=33, chirps=5, multiplexing=multiplexing, residual_video_phase=video_phase)
    positions = generator.uniform([3.0, -20.0, -1.0], [40.0, 20.0, 1.0], (4, 3))
    velocities = generator.uniform(-15.0, 15.0, (4, 3))
    amplitudes = generator.normal(size=4) + 1j * generator.normal(size=4)
    signal = if_signal(radar, positions, velocities, amplitudes)
    table = PathTable(ScatteredPaths.of_points(positions, velocities, amplitudes))
    # Phases of 2e4 cycles in float64 keep 4e-12 cycles; two orders of summation differ by no more than a few of those.
    assert relative_error(signal, if_cube(table, radar)) < 1e-9


def test_the_absolute_baseband_of_another_simulator_is_reproduced():
    # The vector samples at 60 kHz an 80 us chirp; 24 samples a chirp hold those instants as every fifth.
    vector = json.loads(reference_file("vectors", "radarsimpy_baseband.json").read_text(encoding="utf-8"))
    config = vector["config"]
    start_hz, stop_hz = config["f_Hz"]
    gain_db = config["rf_gain_dB"] + config["baseband_gain_dB"]
    radar = Radar(
        waveform=Waveform(
            carrier_hz=start_hz, bandwidth_hz=stop_hz - start_hz, chirp_duration_s=config["T_s"],
            chirp_interval_s=config["T_s"], chirps=1, samples=24, range_bins=24, residual_video_phase=True,
        ),
        array=PAIR,
        front_end=FrontEnd(
            transmit_power_dbm=config["tx_power_dBm"] + gain_db,
            tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern(),
        ),
    )  # fmt: skip
    every = round(radar.waveform.sample_rate_hz / config["fs_Hz"])
    position = np.array([config["target_m"]], dtype=float)
    amplitude = target_amplitudes(radar, position, np.array([config["rcs_dBsm"]]), np.zeros(1))
    # A watt into the load's ohms: the peak voltage of a sinusoid of power P is sqrt(2 P R).
    voltage = np.sqrt(2.0 * config["load_ohm"]) * if_signal(radar, position, np.zeros((1, 3)), amplitude)[0, ::every, 0]
    expected = np.array(vector["baseband_re"]) + 1j * np.array(vector["baseband_im"])
    assert np.abs(voltage[: len(expected)] - expected).max() < 1e-6 * np.abs(expected).max()


def _radar_equation_dbw(radar: Radar, range_m: float, rcs_dbsm: float) -> float:
    """Received power by the radar equation, in decibels, at boresight of the default radar."""
    wavelength = 299_792_458.0 / 77.5e9
    gain_dbi = 2 * 11.1
    return (
        radar.front_end.transmit_power_dbm - 30.0 + gain_dbi + rcs_dbsm
        + 20.0 * np.log10(wavelength) - 30.0 * np.log10(4.0 * np.pi) - 40.0 * np.log10(range_m)
    )  # fmt: skip


def test_power_follows_the_radar_equation(small_radar):
    radar = small_radar(samples=512, chirps=4)
    for bin_index in (20, 40, 80, 160, 320):
        # TX and RX of the full array are not at the origin, which moves the echo by less than 0.05 bins at boresight.
        range_m = bin_index * radar.waveform.range_step_m
        position = np.array([[range_m, 0.0, 0.0]])
        amplitude = target_amplitudes(radar, position, np.array([11.0]), np.array([0.7]))
        cube = if_signal(radar, position, np.zeros((1, 3)), amplitude)
        expected = _radar_equation_dbw(radar, range_m, 11.0)
        assert 10.0 * np.log10(np.mean(np.abs(cube) ** 2)) == pytest.approx(expected, abs=0.05)
        peak = np.abs(range_doppler(cube.astype(np.complex64), radar)).max(axis=(0, 1)).mean()
        assert 20.0 * np.log10(peak) == pytest.approx(expected, abs=0.05)


def test_an_approaching_target_has_negative_range_rate(small_radar):
    radar = small_radar(samples=128, chirps=64)
    position = np.array([[10.0, 2.0, 0.0]])
    direction = position[0] / np.linalg.norm(position[0])
    for speed in (-7.0, 4.0):  # along the line of sight, range rate in m/s
        cube = if_signal(radar, position, speed * direction[None], np.ones(1, dtype=complex))
        power = (np.abs(range_doppler(cube.astype(np.complex64), radar)) ** 2).sum(axis=(0, 2))
        found = radar.waveform.velocities_mps[power.argmax()]
        assert abs(found - speed) <= 0.5 * radar.waveform.velocity_step_mps


def test_noise_power_agrees_with_its_formula(small_radar):
    radar = small_radar(samples=256, chirps=64)
    noise = receiver_noise(radar, np.random.default_rng(7))
    factor = 10.0 ** (radar.front_end.noise_figure_db / 10.0)
    sample_power = 1.380649e-23 * 290.0 * factor * 256 / 80.6e-6
    assert 10.0 * np.log10(np.mean(np.abs(noise) ** 2) / sample_power) == pytest.approx(0.0, abs=0.1)
    measured = np.mean(np.abs(range_doppler(noise, radar)) ** 2)
    assert 10.0 * np.log10(measured / cell_noise_power(radar)) == pytest.approx(0.0, abs=0.1)
    # A periodic Hann window has an equivalent noise bandwidth of 1.5 bins (Harris 1978, Table I), on both axes.
    assert cell_noise_power(radar) == pytest.approx(sample_power * 1.5**2 / (256 * 64), rel=1e-12)


def test_noise_is_circular_and_white(small_radar):
    radar = small_radar(samples=256, chirps=32)
    noise = receiver_noise(radar, np.random.default_rng(8)) / np.sqrt(radar.sample_noise_power_w)
    # 4e5 samples: an estimate of zero deviates by 1.6e-3.
    assert abs(np.mean(noise**2)) < 8e-3
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1].conj())) < 8e-3
    assert abs(np.mean(noise[..., 1:] * noise[..., :-1].conj())) < 8e-3
