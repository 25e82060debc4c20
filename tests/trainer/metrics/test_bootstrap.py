"""Intervals of means, ratios and shares, and of average precisions of several methods on the same frames."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import bootstrap

from trainer.metrics import bootstrap as intervals
from trainer.metrics.bootstrap import bootstrap_mean, bootstrap_ratio, wilson
from trainer.metrics.cells import CellScores, average_precision, pooled


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    generator = np.random.default_rng(1)
    inside = 0
    for draw in range(100):
        interval = bootstrap_mean(generator.normal(2.0, 1.0, 60), seed=draw)
        inside += interval.low <= 2.0 <= interval.high
    assert 86 <= inside <= 100
    wide = bootstrap_mean(generator.normal(2.0, 1.0, 60))
    assert wide.high - wide.low == pytest.approx(2 * 1.96 / np.sqrt(60), rel=0.25)


def test_bootstrap_is_repeatable_and_knows_no_spread_of_one() -> None:
    values = np.random.default_rng(0).random(30)
    assert bootstrap_mean(values, seed=3) == bootstrap_mean(values, seed=3)
    assert bootstrap_mean(values, seed=3) != bootstrap_mean(values, seed=4)
    one = bootstrap_mean(np.array([0.3]))
    assert one.value == 0.3
    assert np.isnan([one.low, one.high]).all()
    same = bootstrap_mean(np.full(10, 0.5))
    assert (same.value, same.low, same.high) == (0.5, 0.5, 0.5)


def test_ratios_are_of_sums() -> None:
    parts, wholes = np.array([1.0, 0.0, 9.0, 2.0]), np.array([2.0, 0.0, 10.0, 4.0])
    interval = bootstrap_ratio(parts, wholes)
    assert interval.value == 12 / 16
    assert interval.low < 12 / 16 < interval.high
    assert bootstrap_ratio(np.zeros(4), np.zeros(4)).value == 0.0
    assert bootstrap_ratio(parts, parts).low == 1.0


def test_wilson_intervals() -> None:
    # Newcombe 1998, table I: 81 of 263 and 0 of 20, Wilson without continuity correction.
    found = wilson(81, 263)
    assert (found.low, found.high) == (pytest.approx(0.2553, abs=1e-4), pytest.approx(0.3662, abs=1e-4))
    nothing = wilson(0, 20)
    assert (nothing.value, nothing.low, nothing.high) == (0.0, 0.0, pytest.approx(0.1611, abs=1e-4))
    assert wilson(20, 20).high == 1.0


TRUTHS = (6, 3, 0, 9, 4, 7, 2)


def frames(seed: int, skill: float) -> list[CellScores]:
    """A method whose matched detections stand ``skill`` above its false alarms; hard frames are hard for every one."""
    generator = np.random.default_rng(seed)
    return [
        CellScores(
            generator.normal(skill + 0.2 * index, 1.0, generator.integers(0, truths + 1)),
            generator.normal(0.0, 1.0, 5),
            truths,
        )
        for index, truths in enumerate(TRUTHS)
    ]


def test_the_interval_is_that_of_frames_drawn_for_all_methods_at_once(monkeypatch):
    """Against the slow way: pool the drawn frames of each method anew."""
    monkeypatch.setattr(intervals, "RESAMPLES", 200)
    of, less = frames(1, 1.5), frames(2, 0.5)

    def gain(drawn):
        more, fewer = (pooled([method[index] for index in drawn]).average_precision() for method in (of, less))
        return more - fewer

    expected = bootstrap(
        (np.arange(len(TRUTHS)),), gain, vectorized=False, n_resamples=200, batch=100, method="percentile",
        rng=np.random.default_rng(3),
    ).confidence_interval  # fmt: skip
    found = average_precision(pooled(of), pooled(less), seed=3)
    assert found.value == pytest.approx(gain(range(len(TRUTHS))))
    assert (found.low, found.high) == (pytest.approx(expected.low), pytest.approx(expected.high))


def test_frames_without_anything_to_detect_have_no_value():
    nothing = pooled([CellScores(np.empty(0), np.ones(2), 0)] * 3)
    assert np.isnan(average_precision(nothing, nothing).value)
