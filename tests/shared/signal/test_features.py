"""Features: eq. (7)-(12) written out in float64, the same in NumPy and torch; the floor that a model error lays."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from shared.physics.errors import InputError
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.radar.waveform import Waveform
from shared.signal.adaptive import adaptive_tables
from shared.signal.features import (
    MAGNITUDE_FLOOR_DB,
    adaptive_features,
    covariance_channels,
    paper_features,
    row_features,
    snapshot_features,
    steering_weights,
)
from shared.signal.model_error import NO_MODEL_ERROR_DB, UNCALIBRATED_DB, model_error_ratio, row_noise

RADAR = Radar(waveform=Waveform(samples=16, chirps=2, range_bins=5), grid=ImageGrid(bins=450))
ARRAYS = sorted(AVR_QDM_110_THINNED_RX)


def snapshots(generator, channels, rows=5):
    """[rows, C] of amplitudes 80 dB apart, like an image's near and far rows [sqrt(W)]."""
    values = generator.standard_normal((rows, channels, 2)) * np.geomspace(1e-4, 1e-8, rows)[:, None, None]
    return (values[..., 0] + 1j * values[..., 1]).astype(np.complex64)


def slow_reference(snapshot, radar, channels):
    """[5, R, U] the paper's features by loops in float64; sign of the steering as in design conventions (+u)."""
    y = radar.array.virtual[channels, 1]
    wavenumber = 2 * np.pi / radar.waveform.wavelength_m
    rows, bins = len(snapshot), radar.grid.bins
    image = np.zeros((rows, bins), complex)
    covariance = np.zeros((rows, bins), complex)
    for r in range(rows):
        s = snapshot[r].astype(complex)
        for j, u in enumerate(radar.grid.u):
            image[r, j] = sum(s[c] * np.exp(1j * wavenumber * u * y[c]) for c in range(len(s))) / len(s)
        matrix = np.outer(s, s.conj())
        matrix = (matrix / np.linalg.norm(matrix))[:29, :29]
        place = 0
        for row in range(len(matrix)):
            for column in range(row, len(matrix)):
                covariance[r, place] = matrix[row, column]
                place += 1
    level = np.log10(np.maximum(np.abs(image) / np.abs(image).max(), 10 ** (MAGNITUDE_FLOOR_DB / 20)))
    level = (level - level.min()) / (level.max() - level.min())
    return np.stack([level, np.angle(image), covariance.real, covariance.imag, np.angle(covariance)])


def wrapped(phase):
    return np.abs(np.exp(1j * phase) - 1)


@pytest.mark.parametrize("name", ARRAYS)
def test_the_paper_s_channels_equal_the_slow_reference_for_every_array(generator, name):
    channels = RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])
    data = snapshots(generator, len(channels))
    expected = slow_reference(data, RADAR, channels)
    found = paper_features(data, steering_weights(RADAR, channels))
    assert found.shape == (5, 5, 450)
    assert found.dtype == np.float32
    for channel in (0, 2, 3):
        np.testing.assert_allclose(found[channel], expected[channel], atol=2e-5)
    # Phases are compared where the value is not within rounding of zero, and on the circle.
    strong = expected[0] > 0.5
    assert wrapped(found[1] - expected[1])[strong].max() < 1e-3
    filled = np.abs(expected[2] + 1j * expected[3]) > 1e-5
    assert wrapped(found[4] - expected[4])[filled].max() < 1e-3


@pytest.mark.parametrize("name", ARRAYS)
def test_torch_gives_what_numpy_gives_and_a_batch_what_single_frames_give(generator, name):
    channels = RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])
    weights = steering_weights(RADAR, channels)
    data = np.stack([snapshots(generator, len(channels)) for _ in range(2)])
    noise = np.array([1e-16, 0.0])
    tensors = torch.from_numpy(data), torch.from_numpy(weights), torch.from_numpy(noise)
    paper, (rows, scale) = paper_features(data, weights), row_features(data, weights, noise)
    torch_paper, (torch_rows, torch_scale) = paper_features(*tensors[:2]), row_features(*tensors)
    for channel in (0, 2, 3):
        np.testing.assert_allclose(torch_paper[:, channel], paper[:, channel], atol=2e-5)
    np.testing.assert_allclose(torch_rows, rows, atol=2e-5)
    np.testing.assert_allclose(torch_scale, scale, rtol=1e-5)
    assert torch_rows.dtype == torch.float32
    assert rows.dtype == np.float32
    np.testing.assert_allclose(row_features(data[1], weights, noise[1])[0], rows[1], atol=2e-5)


def test_a_single_echo_reads_one_at_its_place():
    weights = steering_weights(RADAR, np.arange(48))
    echo = np.conj(weights[:, 300] * 48)[None] * np.complex64(3e-7 * np.exp(2j))
    features, scale = row_features(echo, weights, np.array(1e-17))
    assert scale[0] == pytest.approx(3e-7, rel=1e-5)
    assert features[2, 0].argmax() == 300
    np.testing.assert_allclose(features[:3, 0, 300], [1, 0, 1], atol=1e-5)
    # log10(9e-14 / 1e-17) = 3.954 on the scale from -2 to 8
    assert features[3, 0, 0] == pytest.approx((np.log10(9e-14 / 1e-17) + 2) / 10, abs=1e-5)


def test_the_whole_covariance_equals_eq_13(generator):
    data = snapshots(generator, 12)
    found = covariance_channels(data)
    assert found.shape == (3, 5, 144)
    for row, s in enumerate(data.astype(complex)):
        matrix = np.outer(s, s.conj())
        matrix /= np.linalg.norm(matrix)
        np.testing.assert_allclose(found[0, row] + 1j * found[1, row], matrix.ravel(), atol=1e-6)
        assert wrapped(found[2, row] - np.angle(matrix.ravel())).max() < 1e-2
    np.testing.assert_allclose(covariance_channels(torch.from_numpy(data))[:2], found[:2], atol=1e-6)


SMALL = Radar(grid=ImageGrid(bins=90))
CHANNELS = np.arange(12)
WEIGHTS = steering_weights(SMALL, CHANNELS)
TABLES = adaptive_tables(SMALL, CHANNELS)


def rows(generator, shape=(2, 3)):
    """[..., R, 12] rows 30 dB apart [sqrt(W)]."""
    values = generator.standard_normal((*shape, 12, 2)) @ np.array([1.0, 1.0j])
    return (values * np.array([1e-4, 3e-6, 1e-7])[:, None]).astype(np.complex64)


def test_the_noise_of_a_row_is_the_receiver_s_and_a_share_of_its_power(generator):
    data = rows(generator)[0]
    expected = [1e-12 + 0.01 * sum(abs(complex(x)) ** 2 for x in row) / 12 for row in data]
    np.testing.assert_allclose(row_noise(data, 1e-12, -20.0), expected, rtol=1e-6)
    assert row_noise(data, 1e-12, NO_MODEL_ERROR_DB).tolist() == [1e-12] * 3
    assert model_error_ratio(UNCALIBRATED_DB) == pytest.approx(10**-2.5)


@pytest.mark.parametrize("level", [0.1, np.nan, np.inf])
def test_a_model_error_above_the_row_s_power_is_refused(level):
    with pytest.raises(InputError, match=r"^model_error_db: .*; expected at most 0 dB of the row"):
        model_error_ratio(level)


@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy])
def test_a_network_is_told_the_sum_of_both(generator, library):
    data, noise = rows(generator), np.array([1e-14, 1e-18])
    error = np.array([10**-2.5, 0.0])
    given = library(data), library(noise)
    planes, scale = (np.asarray(values) for values in snapshot_features(*given, library(error)))
    expected = noise[:, None] / scale.astype(float) ** 2 + error[:, None]
    np.testing.assert_allclose(planes[:, 24, :, 0], expected, rtol=1e-5)
    level = np.asarray(row_features(given[0], library(WEIGHTS), given[1], library(error))[0])[:, 3, :, 0]
    np.testing.assert_allclose(10.0 ** -(10.0 * level - 2.0), np.clip(expected, 1e-8, 1e2), rtol=1e-3)
    tables = type(TABLES)(*(library(table) for table in TABLES))
    mixed = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5, library(error))[0])
    floor = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5, 10**-2.5)[0])
    none = np.asarray(adaptive_features(given[0], library(WEIGHTS), given[1], tables, 3, 0.5)[0])
    np.testing.assert_allclose(mixed[0], floor[0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(mixed[1], none[1], rtol=1e-3, atol=1e-4)
    assert np.abs(mixed[0] - none[0]).max() > 0.01
