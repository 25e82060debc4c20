"""Circular Gaussian numbers: the transform against float64, and what it makes against the normal law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from shared.radar.normals import box_muller, fill_circular


def test_the_transform_is_that_of_box_and_muller():
    bits = np.random.default_rng(1).integers(0, 2**64 - 1, 20_000, dtype=np.uint64, endpoint=True)
    bits[:3] = 0, 2**64 - 1, 2**32 - 1
    noise = np.empty((len(bits), 2), dtype=np.float32)
    box_muller(bits, np.float32(3.0), np.empty(len(bits), dtype=np.float32), noise.reshape(-1))
    u = ((bits >> np.uint64(32)).astype(np.float64) + 0.5) / 2.0**32
    cycles = (bits & np.uint64(2**32 - 1)).astype(np.float64) / 2.0**32
    expected = 3.0 * np.sqrt(-2.0 * np.log(u)) * np.exp(2j * np.pi * cycles)
    # Where u is nearly 1 the radius is nearly 0, and float32 tells 6e-8 of u.
    np.testing.assert_allclose(noise[:, 0] + 1j * noise[:, 1], expected, rtol=0.0, atol=6e-5)
    assert np.sqrt(np.mean(np.abs(noise[:, 0] + 1j * noise[:, 1] - expected) ** 2)) < 1e-6
    assert np.abs(noise[0]).max() == pytest.approx(3.0 * np.sqrt(2.0 * 33.0 * np.log(2.0)), rel=1e-6)


def test_numbers_are_normal_to_their_tails():
    noise = np.empty((1_000_000, 2), dtype=np.float32)
    fill_circular(np.random.default_rng(2), 1.0, noise)
    for part in noise.astype(np.float64).T:
        assert stats.kstest(part[:100_000], "norm").pvalue > 1e-3
        for limit in (2.0, 3.0, 4.0):
            expected = 2.0 * stats.norm.sf(limit) * len(part)
            assert abs(np.count_nonzero(np.abs(part) > limit) - expected) < 4.0 * np.sqrt(expected)
        assert abs(part.var() - 1.0) < 4.0 * np.sqrt(2.0 / len(part))
