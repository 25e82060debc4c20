"""Confidence intervals: bootstrap over frames, Wilson for probabilities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, bootstrap

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % confidence interval."""

    value: float
    low: float
    high: float


UNDEFINED = Interval(*[float("nan")] * 3)


def bootstrap_mean(values: NDArray[np.floating], seed: int = 0) -> Interval:
    """Mean of values [n] and its percentile bootstrap interval (Efron 1979) over the n of them.

    One value alone has no spread that could be resampled: its interval is NaN, not of width zero.
    """
    return _bootstrap((np.asarray(values, np.float64),), np.mean, seed)


def bootstrap_ratio(parts: NDArray[np.floating], wholes: NDArray[np.floating], seed: int = 0) -> Interval:
    """Ratio of sums, sum part / sum whole, of n frames and its interval: frames, not detections, are drawn again.

    0 where the wholes add up to nothing.

    :param parts, wholes: [n] of each frame, e.g. true positives and truths
    """

    def ratio(x: NDArray[np.float64], y: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        below = np.sum(y, axis=axis)
        return np.where(below > 0.0, np.sum(x, axis=axis) / np.where(below > 0.0, below, 1.0), 0.0)

    return _bootstrap((np.asarray(parts, np.float64), np.asarray(wholes, np.float64)), ratio, seed)


def bootstrap_frames(
    statistics: Callable[[NDArray[np.int64]], NDArray[np.float64]], frames: int, seed: int = 0
) -> list[tuple[float, float]]:
    """(lower, upper) ends of the intervals of K statistics of a pool of frames, such as the average precision.

    :param statistics: weights [B, frames], how often each frame was drawn, to the statistics [K, B] of each draw
    """

    def of_draws(drawn: NDArray[np.int64], axis: int = -1) -> NDArray[np.float64]:
        draws = drawn.reshape(-1, frames)
        place = draws + frames * np.arange(len(draws))[:, None]
        return statistics(np.bincount(place.ravel(), minlength=draws.size).reshape(draws.shape))

    if frames < 2:
        count = len(statistics(np.ones((1, frames), dtype=np.int64)))
        return [(float("nan"), float("nan"))] * count
    low, high = _percentiles((np.arange(frames),), of_draws, seed)
    return list(zip(low.tolist(), high.tolist(), strict=True))


def wilson(successes: int, trials: int) -> Interval:
    """Share of successes and its Wilson score interval (Wilson 1927), which keeps within 0 and 1."""
    interval = binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / trials, float(interval.low), float(interval.high))


def _bootstrap(samples: tuple[NDArray[np.float64], ...], statistic: Callable[..., Any], seed: int) -> Interval:
    value = float(statistic(*samples, axis=-1))
    if len(samples[0]) < 2:
        return Interval(value, float("nan"), float("nan"))
    low, high = _percentiles(samples, statistic, seed)
    return Interval(value, float(low), float(high))


def _percentiles(samples: tuple[NDArray[Any], ...], statistic: Callable[..., Any], seed: int) -> Any:
    """(lower, upper) ends of the percentile interval of one or more statistics."""
    result = bootstrap(
        samples, statistic, paired=True, vectorized=True, n_resamples=RESAMPLES, batch=100,
        confidence_level=CONFIDENCE, method="percentile", rng=np.random.default_rng(seed),
    )  # fmt: skip
    return result.confidence_interval.low, result.confidence_interval.high
