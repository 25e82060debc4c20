"""The floor that a model error lays under the noise: its equation, its place in every input of a network, none."""

import numpy as np
import pytest
import torch

from shared.physics.errors import InputError
from shared.radar import ImageGrid, Radar
from shared.signal.adaptive import adaptive_tables
from shared.signal.features import adaptive_features, row_features, snapshot_features, steering_weights
from shared.signal.model_error import NO_MODEL_ERROR_DB, UNCALIBRATED_DB, model_error_ratio, row_noise

RADAR = Radar(grid=ImageGrid(bins=90))
CHANNELS = np.arange(12)
WEIGHTS = steering_weights(RADAR, CHANNELS)
TABLES = adaptive_tables(RADAR, CHANNELS)


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


def test_none_changes_no_bit(generator):
    data, noise = torch.from_numpy(rows(generator)), torch.tensor([1e-14, 0.0], dtype=torch.float64)
    for one, other in zip(snapshot_features(data, noise), snapshot_features(data, noise, 0.0), strict=True):
        assert torch.equal(one, other)
    weights = torch.from_numpy(WEIGHTS)
    for one, other in zip(row_features(data, weights, noise), row_features(data, weights, noise, 0.0), strict=True):
        assert torch.equal(one, other)
