"""The adaptive spectrum: its equation written out in float64, the limits it must keep, NumPy and torch alike."""

import numpy as np
import pytest
import torch

from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.signal.adaptive import (
    FLOOR,
    LEAST_POWER,
    MOST_POWER,
    AdaptiveTables,
    adaptive_forms,
    adaptive_powers,
    adaptive_spectrum,
    adaptive_tables,
    bounded_power,
    likes_ratio,
    scanned_angles,
    view_table,
    virtual_view,
)
from shared.signal.features import ADAPTIVE_CHANNELS, ROW_CHANNELS, adaptive_features, row_features, snapshot_features
from shared.signal.imaging import steering_matrix, steering_weights
from shared.signal.windows import angle_window

RADAR = Radar()
BINS = RADAR.grid.bins
ARRAYS = sorted(AVR_QDM_110_THINNED_RX)


def chosen(name):
    return RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])


def echoes(generator, channels, rows=4, targets=2, noise_db=-25.0):
    """([rows, C] complex64 of RMS 1, [rows] relative noise power, [rows, targets] u), strong and a little weaker."""
    y = RADAR.array.virtual[channels, 1]
    u = generator.uniform(-0.8, 0.8, (rows, targets))
    amplitude = np.exp(2j * np.pi * generator.random((rows, targets))) * 10.0 ** (-0.1 * np.arange(targets))
    wavenumber = 2 * np.pi / RADAR.waveform.wavelength_m
    x = np.einsum("rk,rkc->rc", amplitude, np.exp(-1j * wavenumber * u[..., None] * y))
    power = 10.0 ** (noise_db / 10.0)
    x = x + np.sqrt(power / 2) * (generator.standard_normal(x.shape) + 1j * generator.standard_normal(x.shape))
    scale = np.sqrt((np.abs(x) ** 2).mean(-1, keepdims=True))
    return (x / scale).astype(np.complex64), (power / scale[:, 0] ** 2).astype(np.float32), u


def full_manifold(channels, u):
    return np.exp(-1j * 2 * np.pi / RADAR.waveform.wavelength_m * np.outer(RADAR.array.virtual[channels, 1], u))


def slow_powers(x, noise, channels, iterations, rule):
    """P of one snapshot: eq. of the module, full covariance, no distances, float64; the image's angles first."""
    grid = RADAR.grid
    count = int((1.0 - abs(grid.u[0])) / grid.step)
    steps = np.concatenate([np.arange(BINS), -np.arange(1, count + 1), np.arange(BINS, BINS + count + 2)])
    axis = grid.u[0] + grid.step * steps
    a = full_manifold(channels, axis[np.abs(axis) < 1.0])
    power = np.abs(a.conj().T @ x) ** 2 / len(x) ** 2
    for _ in range(iterations):
        white = max(noise, FLOOR * power.sum() + FLOOR)
        inverse = np.linalg.inv(a * power @ a.conj().T + white * np.eye(len(x)))
        q, s = a.conj().T @ inverse @ x, np.einsum("cn,cd,dn->n", a.conj(), inverse, a).real
        power = np.abs(q / s) ** 2 if rule == "iaa" else np.clip(power * np.abs(q) ** 2 / s, LEAST_POWER, MOST_POWER)
    return power


def likes_powers(x, noise, tables, iterations):
    """By the "likes" rule, as networks take its steps."""
    power = adaptive_powers(x, noise, tables, 0)
    for _ in range(iterations):
        power = bounded_power(power * likes_ratio(*adaptive_forms(power, x, noise, tables)))
    return power


@pytest.mark.parametrize(("rule", "iterations"), [("iaa", 0), ("iaa", 1), ("iaa", 5), ("likes", 1), ("likes", 5)])
@pytest.mark.parametrize("name", ARRAYS)
def test_it_equals_its_equation_written_out(generator, name, rule, iterations):
    channels = chosen(name)
    x, noise, _ = echoes(generator, channels)
    tables = adaptive_tables(RADAR, channels)
    tensors = AdaptiveTables(*(torch.from_numpy(table) for table in tables))
    given, in_torch = (x, noise), (torch.from_numpy(x), torch.from_numpy(noise))
    rows = zip(x.astype(complex), noise.astype(float), strict=True)
    expected = np.sqrt([slow_powers(*row, channels, iterations, rule) for row in rows])
    if rule == "iaa":
        found = adaptive_spectrum(*given, tables, BINS, iterations)
        again = adaptive_spectrum(*in_torch, tensors, BINS, iterations)
        expected = expected[:, :BINS]
    else:
        found = np.sqrt(likes_powers(*given, tables, iterations))
        again = likes_powers(*in_torch, tensors, iterations).sqrt()
    assert (found.dtype, again.dtype) == (np.float32, torch.float32)
    np.testing.assert_allclose(found, expected, atol=5e-3)
    np.testing.assert_allclose(again, found, atol=5e-3)


def test_the_features_are_the_row_s_and_the_compressed_spectrum(generator):
    channels = chosen("sparse4")
    weights, tables = steering_weights(RADAR, channels), adaptive_tables(RADAR, channels)
    x, _, _ = echoes(generator, channels, rows=6)
    levels = np.geomspace(1e-4, 1e-8, 6).astype(np.float32)
    frames = (x * levels[:, None]).reshape(2, 3, -1)
    noise_power = np.array([1e-14, 0.0])
    stacked, scale = adaptive_features(frames, weights, noise_power, tables, 3, 0.5)
    row, row_scale = row_features(frames, weights, noise_power)
    assert stacked.shape == (2, len(ADAPTIVE_CHANNELS), 3, BINS)
    assert stacked.dtype == np.float32
    np.testing.assert_array_equal(stacked[:, : len(ROW_CHANNELS)], row)
    np.testing.assert_array_equal(scale, row_scale)
    relative = (noise_power[:, None] / scale.astype(float) ** 2).astype(np.float32)
    expected = np.sqrt(adaptive_spectrum(x.reshape(2, 3, -1), relative, tables, BINS, 3))
    np.testing.assert_allclose(stacked[:, 4], expected, atol=2e-3)


@pytest.mark.parametrize("value", [0.0, 1e-30, 1e30])
@pytest.mark.parametrize("noise", [0.0, 1e-40, 1e20])
def test_hard_rows_are_finite_in_both_libraries(value, noise):
    channels = chosen("sparse4")
    weights, tables = steering_weights(RADAR, channels), adaptive_tables(RADAR, channels)
    data = np.full((1, 5, 12), value, np.complex64)
    data[0, 2:] = 0
    found, _ = adaptive_features(data, weights, np.array([noise]), tables, 5, 0.5)
    assert np.isfinite(found).all()
    assert np.all(found[0, 4, 2:] == 0)
    tensors = AdaptiveTables(*(torch.from_numpy(table) for table in tables))
    arguments = torch.from_numpy(data), torch.from_numpy(weights), torch.tensor([noise], dtype=torch.float64)
    again, _ = adaptive_features(*arguments, tensors, 5, 0.5)
    assert torch.isfinite(again).all()
    np.testing.assert_allclose(again, found, atol=5e-3)


def slow_view(power, q, channels, bins):
    """[len(bins)] of one row: the module's sum over angles, one image bin at a time."""
    sensor, u = RADAR.virtual_sensor, scanned_angles(RADAR)
    wavenumber = 2 * np.pi / RADAR.waveform.wavelength_m
    y = sensor.virtual[:, 1]
    weights = angle_window("taylor-30", sensor.channels) / sensor.channels
    middle = RADAR.array.virtual[channels, 1].mean()
    image = np.zeros(len(bins))
    for place, towards in enumerate(RADAR.grid.u[bins]):
        phases = [wavenumber * ((towards - angle) * y + angle * middle) for angle in u]
        h = np.array([np.sum(weights * np.exp(1j * phase)) for phase in phases])
        image[place] = np.abs(np.sum(h * power * q))
    return image


def test_the_virtual_view_equals_its_sum_written_out(generator):
    channels = chosen("sparse4")
    x, noise, _ = echoes(generator, channels, rows=1)
    tables, view = adaptive_tables(RADAR, channels), view_table(RADAR, channels, "taylor-30")
    power = likes_powers(x, noise, tables, 5)
    q, _ = adaptive_forms(power, x, noise, tables)
    found = virtual_view(power, q, view)
    assert found.dtype == np.float32
    # The peaks and a tenth of the other bins: the slow sum takes 40 ms for each.
    bins = np.union1d(np.arange(0, BINS, 10), np.argsort(found[0])[-10:])
    expected = slow_view(power[0].astype(float), q[0].astype(complex), channels, bins)
    np.testing.assert_allclose(found[0, bins], expected, atol=1e-4)
    again = virtual_view(*(torch.from_numpy(part) for part in (power, q, view)))
    np.testing.assert_allclose(again, found, atol=1e-4)


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("place", [60, 225, 371])
def test_a_strong_echo_is_seen_as_the_virtual_sensor_sees_it(name, place):
    """One plane wave at 40 dB, at a scanned angle: main lobe within 2 %, all else within 1 % of the peak."""
    channels, sensor = chosen(name), RADAR.virtual_sensor
    u = RADAR.grid.u[place]
    wave = np.exp(-1j * 2 * np.pi / RADAR.waveform.wavelength_m * u * sensor.virtual[:, 1])
    weights = angle_window("taylor-30", sensor.channels)[:, None] / sensor.channels * steering_matrix(RADAR, sensor)
    truth = np.abs(wave @ weights)
    x = full_manifold(channels, np.array([u])).T.astype(np.complex64)
    noise = np.full(1, 1e-4, np.float32)
    tables = adaptive_tables(RADAR, channels)
    power = likes_powers(x, noise, tables, 12)
    filtered, _ = adaptive_forms(power, x, noise, tables)
    seen = virtual_view(power, filtered, view_table(RADAR, channels, "taylor-30"))[0]
    assert seen.argmax() == place
    np.testing.assert_allclose(seen, truth, atol=0.02)
    away = np.abs(np.arange(BINS) - place) > 20
    np.testing.assert_allclose(seen[away], truth[away], atol=0.01)


def test_snapshot_features_are_the_rows_and_their_noise(generator):
    shape = (2, 3, 12)
    frames = (generator.standard_normal((*shape, 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)
    frames *= np.geomspace(1e-9, 1.0, 3, dtype=np.float32)[None, :, None]
    frames[1, 2] = 0
    noise_power = np.array([1e-12, 0.0])
    planes, scale = snapshot_features(frames, noise_power)
    assert planes.shape == (2, 25, 3, 1)
    assert planes.dtype == np.float32
    back = (planes[:, :12, :, 0] + 1j * planes[:, 12:24, :, 0]).swapaxes(1, 2) * scale[..., None]
    np.testing.assert_allclose(back, frames, rtol=1e-5)
    assert scale[1, 2] == 0.0
    np.testing.assert_allclose(planes[0, 24, :, 0], np.minimum(1e-12 / scale[0].astype(float) ** 2, 1e6), rtol=1e-4)
    # Over nothing every noise is as large as can be.
    assert planes[1, 24, :, 0].tolist() == [0.0, 0.0, 1e6]
    again, again_scale = snapshot_features(torch.from_numpy(frames), torch.from_numpy(noise_power))
    np.testing.assert_allclose(again, planes, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(again_scale, scale, rtol=1e-6)


def test_a_prior_multiplies_the_powers_of_each_iteration():
    """Three iterations written out; NumPy and torch alike; a flat one changes no bit."""
    generator, channels = np.random.default_rng(8), chosen("sparse6")
    x, noise, _ = echoes(generator, channels)
    tables = adaptive_tables(RADAR, channels)
    angles = len(scanned_angles(RADAR))
    prior = generator.uniform(0.1, 1.0, (len(x), angles)).astype(np.float32)
    expected = adaptive_powers(x, noise, tables, 0)
    for _ in range(3):
        q, s = adaptive_forms(expected, x, noise, tables)
        expected = np.abs(q / s) ** 2 * prior
    found = adaptive_powers(x, noise, tables, 3, prior)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
    of_torch = AdaptiveTables(*map(torch.from_numpy, tables))
    in_torch = adaptive_powers(torch.from_numpy(x), torch.from_numpy(noise), of_torch, 3, torch.from_numpy(prior))
    np.testing.assert_allclose(in_torch.numpy(), found, rtol=2e-2, atol=1e-4)
    flat = adaptive_powers(x, noise, tables, 3, np.ones_like(prior))
    np.testing.assert_array_equal(flat, adaptive_powers(x, noise, tables, 3))


def test_the_phase_of_an_echo_is_that_in_the_middle_of_the_channels():
    channels, u = chosen("sparse6"), scanned_angles(RADAR)
    middle = np.exp(-2j * np.pi / RADAR.waveform.wavelength_m * u * RADAR.array.virtual[channels, 1].mean())
    expected = full_manifold(channels, u).conj() * middle
    np.testing.assert_allclose(adaptive_tables(RADAR, channels).matched, expected, atol=1e-6)
