"""The front end's imperfections: conversion, phase noise, transmitters that take turns; and how a radar states them."""

import json

import numpy as np
import pytest
from oracles import receiver_noise
from small_radar import write_radar

from shared.dataset.reading import radar_of
from shared.physics.units import dbm_to_watt
from shared.radar import Radar, load_radar
from shared.radar.arrays import AntennaArray
from shared.radar.front_end import Converter, FrontEnd, PhaseNoise
from shared.radar.receiver import digitised, received, with_phase_noise
from shared.radar.waveform import Waveform
from shared.signal.spectrum import range_doppler
from shared.signal.windows import power_in_cell

PAIR = AntennaArray(tx_m=((0.0, 0.01, 0.0), (0.0, -0.01, 0.0)), rx_m=((0.0, 0.0, 0.0), (0.0, 0.002, 0.0)))


def tone(radar: Radar, range_bin: float, amplitude: float = 1.0) -> np.ndarray:
    """A cube with the echo of one delay in every channel and chirp."""
    n, waveform = np.arange(radar.waveform.samples), radar.waveform
    line = amplitude * np.exp(2j * np.pi * n * range_bin / waveform.samples)
    return np.tile(line[None, :, None], (waveform.chirps, 1, radar.array.channels)).astype(np.complex64)


# Conversion


@pytest.mark.parametrize("bits", [8, 12])
def test_a_tone_of_full_scale_is_6_db_a_bit_above_its_quantisation(small_radar, bits):
    radar = small_radar(samples=1024, chirps=8)
    converter = Converter(bits=bits, full_scale_dbm=-40.0)
    amplitude = np.sqrt(dbm_to_watt(-40.0)) * (1.0 - 1e-3)
    ideal = tone(radar, 123.456, amplitude)
    recorded = digitised(ideal, converter)
    error = np.mean(np.abs(recorded.cube.astype(complex) - ideal) ** 2)
    assert 10.0 * np.log10(np.mean(np.abs(ideal) ** 2) / error) == pytest.approx(6.02 * bits + 1.76, abs=0.1)
    assert recorded.conversion_w == pytest.approx(error, rel=1e-3, abs=0.0)


def test_what_is_too_strong_is_cut_off_and_counted(small_radar):
    radar = small_radar(samples=1000, chirps=1)
    full_scale = np.sqrt(dbm_to_watt(-40.0))
    recorded = digitised(tone(radar, 100.3, 2.0 * full_scale), Converter(bits=10, full_scale_dbm=-40.0))
    cube, saturated = recorded.cube, recorded.saturated
    assert max(cube.real.max(), cube.imag.max()) <= full_scale
    assert min(cube.real.min(), cube.imag.min()) >= -full_scale
    # |cos| > 1/2 over two thirds of its period, for I and Q of each sample.
    assert saturated / (2 * cube.size) == pytest.approx(2 / 3, abs=0.01)
    assert digitised(tone(radar, 100.3, 0.99 * full_scale), Converter(bits=10, full_scale_dbm=-40.0)).saturated == 0


@pytest.mark.parametrize(("steps", "off"), [(0.02, 0.07), (0.5, 0.05), (20.0, 0.05)])
def test_what_the_converter_adds_to_noise_is_known(small_radar, steps, off):
    """Of noise alone, so many steps strong: its power in the cells after both transforms."""
    radar = small_radar(samples=256, chirps=64)
    half = np.sqrt(radar.sample_noise_power_w / 2.0) / steps * 2**7
    noise = receiver_noise(radar, np.random.default_rng(3))
    recorded = digitised(noise, Converter(bits=8, full_scale_dbm=float(10.0 * np.log10(half**2) + 30.0)))
    found = np.mean(np.abs(range_doppler(recorded.cube, radar)) ** 2)
    expected = power_in_cell(radar.sample_noise_power_w + recorded.conversion_w, radar.waveform)
    # Below a step the rounding is not independent of what is rounded: half a step, q^2 / 2, is all that there is.
    assert found == pytest.approx(expected, rel=off, abs=0.0)
    assert recorded.conversion_w >= 0.99 * (half / 2**7) ** 2 / 6.0


# Phase noise


def by_the_definition(radar: Radar, noise: PhaseNoise, range_bin: int, seed: int) -> np.ndarray:
    """[4 samples] exp(j (phi(t) - phi(t - tau))) over one chirp, phi summed from its Fourier coefficients in float64.

    Four times as dense as the radar's own samples, so that no sideband is folded.
    """
    waveform = radar.waveform
    m, t = np.arange(1, waveform.samples), np.arange(4 * waveform.samples) / (4 * waveform.samples)
    frequency = m / waveform.chirp_duration_s
    level = 10.0 ** (noise.level_dbc_per_hz / 10.0) / (1.0 + (frequency / noise.loop_bandwidth_hz) ** 2)
    draw = np.random.default_rng(seed).standard_normal((2, len(m))) * np.sqrt(level / waveform.chirp_duration_s / 2.0)
    late = range_bin / waveform.bandwidth_hz / waveform.chirp_duration_s

    def phi(time):
        return 2.0 * np.real(np.exp(2j * np.pi * np.outer(time, m)) @ (draw[0] + 1j * draw[1]))

    return np.exp(1j * (phi(t) - phi(t - late)))


@pytest.mark.parametrize("range_bin", [7, 40, 63])
def test_phase_noise_is_the_difference_of_the_oscillators_phases(small_radar, range_bin):
    radar = small_radar(samples=64, chirps=1)
    noise = PhaseNoise(level_dbc_per_hz=-90.0, loop_bandwidth_hz=1e5)
    ideal = tone(radar, range_bin)
    error = np.fft.fft(with_phase_noise(ideal, radar, noise, np.random.default_rng(3))[0, :, 0] - ideal[0, :, 0]) / 64
    dense = np.exp(2j * np.pi * np.arange(256) * range_bin / 64 / 4)
    expected = np.fft.fft((by_the_definition(radar, noise, range_bin, 3) - 1.0) * dense)[:64] / 256
    assert np.linalg.norm(expected) > 1e-5
    # What is left is the second order of the phase, and float32.
    assert np.linalg.norm(error - expected) < 5e-3 * np.linalg.norm(expected)


def test_all_receivers_share_the_oscillator_and_turns_do_not(small_radar):
    noise = PhaseNoise(level_dbc_per_hz=-95.0)
    for multiplexing, shared in (("simultaneous", True), ("tdm", False)):
        radar = small_radar(samples=64, chirps=2, multiplexing=multiplexing).model_copy(update={"array": PAIR})
        ideal = tone(radar, 30)
        error = with_phase_noise(ideal, radar, noise, np.random.default_rng(5)) - ideal
        by_channel = error.transpose(2, 0, 1)  # rx-major: TX 0, TX 1 at RX 0, then at RX 1
        np.testing.assert_allclose(by_channel[0], by_channel[2], atol=1e-6)
        assert np.abs(by_channel[0]).max() > 1e-4
        assert np.allclose(by_channel[0], by_channel[1], atol=1e-6) == shared
        assert not np.allclose(error[0], error[1], atol=1e-6)  # chirp by chirp anew


def test_the_phase_that_is_left_is_what_a_long_run_shows():
    waveform = Waveform(samples=128, range_bins=128)
    noise = PhaseNoise(level_dbc_per_hz=-90.0, loop_bandwidth_hz=2e5)
    radar = Radar(waveform=waveform)
    # The farthest bin of all, so that the mean square of the definition is that of residual_rad.
    draws = [by_the_definition(radar, noise, 128, seed) for seed in range(200)]
    assert np.std(np.angle(draws)) == pytest.approx(noise.residual_rad(waveform), rel=0.05)


# The whole receiver


def test_an_ideal_receiver_adds_noise_alone_and_without_a_generator_nothing(small_radar):
    radar = small_radar()
    ideal = tone(radar, 20)
    noisy = received(ideal, radar, np.random.default_rng(7))
    assert (noisy.saturated, noisy.conversion_w) == (0, 0.0)
    assert noisy.cube.tobytes() == (ideal + receiver_noise(radar, np.random.default_rng(7))).tobytes()
    assert received(ideal, radar, None).cube.tobytes() == ideal.tobytes()


def test_every_imperfection_is_applied_in_order_and_reproducibly(small_radar):
    phase_noise, converter = PhaseNoise(level_dbc_per_hz=-90.0), Converter(bits=12, full_scale_dbm=-80.0)
    front_end = FrontEnd(phase_noise=phase_noise, converter=converter)
    radar = small_radar().model_copy(update={"front_end": front_end})
    ideal = tone(radar, 20, 1e-6)
    one, again = (received(ideal, radar, np.random.default_rng(7)).cube for _ in range(2))
    assert one.tobytes() == again.tobytes()
    generator = np.random.default_rng(7)
    by_hand = with_phase_noise(ideal, radar, phase_noise, generator) + receiver_noise(radar, generator)
    assert one.tobytes() == digitised(by_hand, converter).cube.tobytes()
    # Without noise there is no phase noise either; the converter stays.
    assert received(ideal, radar, None).cube.tobytes() == digitised(ideal, converter).cube.tobytes()


# In a radar's file


FULL = """[front_end]
tx_polarization = "V"
rx_polarization = "H"
[front_end.phase_noise]
level_dbc_per_hz = -95
[front_end.converter]
bits = 12
full_scale_dbm = -30
"""


def test_the_front_end_is_read_and_comes_back_from_the_metadata(tmp_path):
    radar = load_radar(write_radar(tmp_path, FULL))
    assert radar.front_end.cross_polarized
    assert radar.front_end.phase_noise == PhaseNoise(level_dbc_per_hz=-95.0, loop_bandwidth_hz=300e3)
    assert radar.front_end.converter == Converter(bits=12, full_scale_dbm=-30.0)
    assert radar_of(json.loads(json.dumps(radar.metadata(), allow_nan=False))) == radar
    assert not FrontEnd().cross_polarized
    assert (FrontEnd().phase_noise, FrontEnd().converter) == (None, None)


def test_a_dataset_from_before_these_fields_is_read_as_without_them():
    description = Radar().metadata()
    for name in ("tx_polarization", "rx_polarization", "phase_noise", "converter"):
        del description["radar"][name]
    assert radar_of(description) == Radar()
