"""Orthogonal matching pursuit: exact cases, the continuous angles, the rates of false alarms."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from paper_arrays import ARRAYS, U, echoes, noise, some_rows

from trainer.estimators.array import uniform_axis
from trainer.estimators.omp import FALSE_ALARM, OrthogonalMatchingPursuit, largest_share_of_noise


def test_omp_finds_separate_targets_exactly() -> None:
    array = ARRAYS["full"]
    bins = np.array([100, 225, 340])
    strengths = np.array([1.0, 0.5j, -0.2])
    snapshot = echoes(array, U[None, bins], strengths[None])
    image = OrthogonalMatchingPursuit().image(snapshot, array, U, 1e-12)[0]
    np.testing.assert_array_equal(np.flatnonzero(image), bins)
    np.testing.assert_allclose(image[bins], np.abs(strengths), rtol=1e-6)


def test_newtonised_omp_leaves_the_grid() -> None:
    array = ARRAYS["full"]
    u = U[[100, 225, 340]] + 0.4 * (U[1] - U[0])
    strengths = np.array([1.0, 0.5j, -0.2])
    snapshot = echoes(array, u[None], strengths[None]) + noise(array, 1, 1e-10, np.random.default_rng(3))
    image = OrthogonalMatchingPursuit("cfar").image(snapshot, array, U, 0.0)[0]
    np.testing.assert_array_equal(np.flatnonzero(image), [100, 225, 340])
    np.testing.assert_allclose(image[[100, 225, 340]], np.abs(strengths), rtol=1e-4)


@pytest.mark.parametrize("stop", ["noise", "cfar"])
def test_omp_of_noise_alone_keeps_its_false_alarm_rate(stop: Literal["noise", "cfar"]) -> None:
    rows = 3000
    for array in (ARRAYS["sparse6"], ARRAYS["sparse4"]):
        x = noise(array, rows, 4.0, np.random.default_rng(11))
        share = np.mean(OrthogonalMatchingPursuit(stop).image(x, array, U, 4.0).any(axis=1))
        # Both rules are set to 1 %, of which the axis shows 88 %: five standard deviations either way.
        assert abs(share - 0.0088) < 5.0 * np.sqrt(FALSE_ALARM / rows)


def test_the_cfar_rule_needs_no_noise_power() -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array, noise_power=0.01)
    images = [OrthogonalMatchingPursuit("cfar").image(rows, array, U, power) for power in (0.0, 0.01, 100.0)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])
    assert images[0].any()


def test_largest_share_of_noise_is_reached_as_often_as_said() -> None:
    array = ARRAYS["sparse4"]
    rows = 20_000
    x = noise(array, rows, 1.0, np.random.default_rng(2))
    axis = uniform_axis(array, 12)
    best = np.abs(x @ array.manifold(axis).conj()).max(axis=1) ** 2 / array.channels
    share = np.mean(best / np.sum(np.abs(x) ** 2, axis=1) > largest_share_of_noise(array, array.channels))
    assert abs(share - FALSE_ALARM) < 4.0 * np.sqrt(FALSE_ALARM / rows)
    assert largest_share_of_noise(array, 1) == 1.0
