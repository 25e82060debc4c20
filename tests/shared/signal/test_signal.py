"""Eq. (1)-(2) as a signal: level, signs, noise; range-Doppler spectra, the choice of Doppler cells, windows."""

import json

import numpy as np
import pytest
from oracles import if_cube, receiver_noise, reference_file, relative_error
from scipy.signal import get_window

from datafactory.paths.table import PathTable, ScatteredPaths
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal import if_signal, target_amplitudes
from shared.signal.spectrum import RAYLEIGH_DEVIATION, RAYLEIGH_MEAN, range_doppler, select_doppler
from shared.signal.windows import angle_window, cell_noise_power, hann

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


def test_power_follows_the_radar_equation(small_radar):
    radar = small_radar(samples=512, chirps=4)
    wavelength, gain_dbi, rcs_dbsm = 299_792_458.0 / 77.5e9, 2 * 11.1, 11.0
    for bin_index in (20, 40, 80, 160, 320):
        # TX and RX of the full array are not at the origin, which moves the echo by less than 0.05 bins at boresight.
        range_m = bin_index * radar.waveform.range_step_m
        position = np.array([[range_m, 0.0, 0.0]])
        amplitude = target_amplitudes(radar, position, np.array([rcs_dbsm]), np.array([0.7]))
        cube = if_signal(radar, position, np.zeros((1, 3)), amplitude)
        expected = (
            radar.front_end.transmit_power_dbm - 30.0 + gain_dbi + rcs_dbsm
            + 20.0 * np.log10(wavelength) - 30.0 * np.log10(4.0 * np.pi) - 40.0 * np.log10(range_m)
        )  # fmt: skip
        assert 10.0 * np.log10(np.mean(np.abs(cube) ** 2)) == pytest.approx(expected, abs=0.05)
        peak = np.abs(range_doppler(cube.astype(np.complex64), radar)).max(axis=(0, 1)).mean()
        assert 20.0 * np.log10(peak) == pytest.approx(expected, abs=0.05)


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


def spectra_of(radar: Radar, ranges_m, velocities_mps, amplitudes) -> np.ndarray:
    """[R, chirps, C] of targets at boresight."""
    positions, velocities = np.zeros((2, len(ranges_m), 3))
    positions[:, 0], velocities[:, 0] = ranges_m, velocities_mps
    cube = if_signal(radar, positions, velocities, np.array(amplitudes, dtype=complex))
    return range_doppler(cube.astype(np.complex64), radar)


def test_spectra_are_the_windowed_sums(small_radar):
    radar = small_radar(samples=16, chirps=6, range_bins=10)
    generator = np.random.default_rng(1)
    cube = (generator.normal(size=(6, 16, 2)) + 1j * generator.normal(size=(6, 16, 2))).astype(np.complex64)
    spectra = range_doppler(cube, radar)
    assert spectra.shape == (10, 6, 2)
    assert spectra.dtype == np.complex64
    range_window, doppler_window = hann(16) / hann(16).sum(), hann(6) / hann(6).sum()
    for row, cell in ((0, 3), (4, 0), (9, 5)):
        n, m = np.arange(16), np.arange(6)
        kernel = np.outer(
            doppler_window * np.exp(-2j * np.pi * (cell - 3) * m / 6), range_window * np.exp(-2j * np.pi * row * n / 16)
        )
        np.testing.assert_allclose(spectra[row, cell], np.einsum("mn,mnc->c", kernel, cube), atol=1e-6)


@pytest.mark.parametrize("chirps", [1, 2, 5, 16])
@pytest.mark.parametrize("samples", [1, 9, 32])
def test_an_on_grid_line_reads_its_amplitude(small_radar, chirps, samples):
    radar = small_radar(samples=samples, chirps=chirps)
    n, m = np.arange(samples), np.arange(chirps)
    row, cell = samples // 3, chirps // 4
    line = np.exp(2j * np.pi * ((cell - chirps // 2) * m[:, None] / chirps + row * n / samples))
    spectra = range_doppler((0.7j * line)[..., None].astype(np.complex64), radar)
    assert spectra[row, cell, 0] == pytest.approx(0.7j, abs=1e-5)


def test_peaks_stand_in_order_of_strength(small_radar):
    radar = small_radar(chirps=64)
    step = radar.waveform.velocity_step_mps
    spectra = spectra_of(radar, [4.5] * 3, [-20 * step, 0.0, 20 * step], [0.2, 0.5, 1.0])
    row = round(4.5 / radar.waveform.range_step_m)
    assert select_doppler(spectra, 1e-12).cells[:, row].tolist() == [52, 32, 12]
    assert select_doppler(spectra, 1e-12, peaks=2).cells[:, row].tolist() == [52, 32]


THRESHOLD = (RAYLEIGH_MEAN + 6.0 * RAYLEIGH_DEVIATION / np.sqrt(48)) * 1e-3


@pytest.mark.parametrize(
    ("noise_power", "level", "second"),
    [(1e-6, 0.999 * THRESHOLD, 5), (1e-6, 1.001 * THRESHOLD, 20), (0.0, 10.0**-4.005, 5), (0.0, 10.0**-3.995, 20)],
)
def test_a_second_peak_stands_above_the_noise_and_within_80_db(noise_power, level, second):
    spectra = np.zeros((1, 32, 48), dtype=np.complex64)
    spectra[0, 5], spectra[0, 20] = 1.0, level
    assert select_doppler(spectra, noise_power).cells[:2, 0].tolist() == [5, second]


def test_noise_alone_has_no_second_peak(small_radar):
    radar = small_radar(samples=128, chirps=64)
    spectra = range_doppler(receiver_noise(radar, np.random.default_rng(3)), radar)
    selection = select_doppler(spectra, cell_noise_power(radar))
    np.testing.assert_array_equal(selection.cells[0], np.abs(spectra).mean(axis=2).argmax(axis=1))
    # Six deviations: not one of 8000 cells.
    assert (selection.cells == selection.cells[0]).all()
    # The constants of the threshold are those of the noise's magnitude.
    normalised = np.abs(spectra) / np.sqrt(cell_noise_power(radar))
    assert normalised.mean() == pytest.approx(RAYLEIGH_MEAN, abs=0.01)
    assert normalised.std() == pytest.approx(RAYLEIGH_DEVIATION, abs=0.01)


LENGTHS = (2, 3, 4, 5, 16, 63, 128, 450, 1024)


@pytest.mark.parametrize("length", LENGTHS)
def test_the_periodic_hann_window_is_scipys_to_the_last_bit(length):
    np.testing.assert_array_equal(hann(length), get_window("hann", length, fftbins=True))


@pytest.mark.parametrize("length", LENGTHS[1:])
@pytest.mark.parametrize(
    ("name", "window"), [("hann", "hann"), ("taylor-25", ("taylor", 4, 25)), ("taylor-30", ("taylor", 4, 30))]
)
def test_windows_over_the_elements_are_scipys_of_mean_one(name, window, length):
    expected = get_window(window, length, fftbins=False)
    np.testing.assert_allclose(angle_window(name, length), expected / expected.mean(), rtol=0.0, atol=4e-15)


def test_a_single_sample_has_weight_one_and_an_unknown_name_is_refused():
    assert hann(1).tolist() == angle_window("taylor-30", 2).tolist()[:1] == [1.0]
    with pytest.raises(ValueError, match="expected one of"):
        angle_window("taylor-35", 8)


def test_peaks_wrap_around_the_doppler_axis(small_radar):
    """A peak's neighbours, 6 dB down, stand on either side of the fold."""
    radar = small_radar(chirps=16)
    row = round(4.5 / radar.waveform.range_step_m)
    for cell in (0, 15):
        spectra = spectra_of(radar, [4.5], [(cell - 8) * radar.waveform.velocity_step_mps], [1.0])
        assert select_doppler(spectra, 1e-12).cells[:, row].tolist() == [cell] * 3
