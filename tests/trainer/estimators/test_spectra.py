"""Delay-and-sum, IAA, SPICE and LIKES against their papers, one snapshot and one angle at a time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, U, echoes, noise, some_rows

from trainer.estimators.adaptive import FLOOR, IterativeAdaptive, SparseCovariance
from trainer.estimators.array import LineArray, scan_axis
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.baselines import DelayAndSum


def test_windows_trade_sidelobes_for_width() -> None:
    array = ARRAYS["full"]
    snapshot = echoes(array, np.zeros((1, 1)), np.ones((1, 1), dtype=complex))
    u = np.linspace(-0.85, 0.85, 4001)
    highest = []
    for window in ("none", "hann", "hamming"):
        level = 20.0 * np.log10(np.maximum(DelayAndSum(window).image(snapshot, array, u, 0.0)[0], 1e-12))
        highest.append(level[np.abs(u) > 3.0 * array.resolution_cell].max())
    assert highest[0] > -22.0
    assert highest[1] < -40.0
    assert -46.0 < highest[2] < -40.0


def slow_covariance_methods(
    x: NDArray[np.complex128], array: LineArray, scan: NDArray[np.float64], noise_power: float, method: str, steps: int
) -> NDArray[np.float64]:
    """One snapshot, one angle at a time, straight from the papers."""
    manifold = array.manifold(scan)
    power = np.array([abs(np.vdot(a, x)) ** 2 for a in manifold.T]) / array.channels**2
    shown = np.sqrt(power)
    for _ in range(steps):
        covariance = sum(p * np.outer(a, a.conj()) for p, a in zip(power, manifold.T, strict=True))
        load = FLOOR * covariance[0, 0].real if method == "iaa" else noise_power
        inverse = np.linalg.inv(covariance + load * np.eye(array.channels))
        filtered = np.array([abs(np.vdot(a, inverse @ x)) for a in manifold.T])
        form = np.array([np.vdot(a, inverse @ a).real for a in manifold.T])
        if method == "iaa":
            shown = filtered / form
            power = shown**2
        else:
            weight = {
                "likes": filtered / form,
                "likes of the paper": 1.0 / np.sqrt(form),
                "spice": np.linalg.norm(x) / np.sqrt(array.channels),
            }[method]
            shown, power = power * filtered, power * filtered * weight
    return shown


@pytest.mark.parametrize("method", ["iaa", "spice", "likes"])
def test_covariance_methods_follow_their_papers(method: str) -> None:
    array, u = ARRAYS["sparse4"], U[::9]
    rows = some_rows(array, rows=2)
    estimator = IterativeAdaptive() if method == "iaa" else SparseCovariance(reweighted=method == "likes")
    estimator.iterations = 4
    image = estimator.image(rows, array, u, 1e-3)
    scan, shown = scan_axis(array, u)
    for row, snapshot in zip(image, rows, strict=True):
        expected = slow_covariance_methods(snapshot, array, scan, 1e-3, method, 4)[shown]
        np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-7)


def test_the_square_of_the_paper_s_step_ends_where_the_paper_s_does() -> None:
    array, u = ARRAYS["sparse4"], U[::9]
    snapshot = echoes(array, u[[[17, 30]]], np.array([[1.0, 0.6j]]))
    snapshot += noise(array, 1, 1e-2, np.random.default_rng(3))
    estimator = SparseCovariance(reweighted=True)
    estimator.iterations = 100
    scan, shown = scan_axis(array, u)
    expected = slow_covariance_methods(snapshot[0], array, scan, 1e-2, "likes of the paper", 300)[shown]
    found = estimator.image(snapshot, array, u, 1e-2)[0]
    assert expected.max() > 0.9
    np.testing.assert_allclose(found, expected, atol=0.01 * expected.max())
    start = slow_covariance_methods(snapshot[0], array, scan, 1e-2, "likes of the paper", 2)[shown]
    assert np.abs(start - expected).max() > 0.1 * expected.max()


@pytest.mark.parametrize("method", ["iaa", "likes", "spice"])
def test_a_target_beyond_the_axis_is_not_drawn_inside_it(method: str) -> None:
    array = ARRAYS["sparse6"]
    snapshot = echoes(array, np.array([[0.93, -0.2]]), np.array([[1.0, 0.1 + 0.0j]]))
    snapshot += noise(array, 1, 1e-5, np.random.default_rng(0))
    image = ESTIMATORS[method]().image(snapshot, array, U, 1e-5)[0]
    away = np.abs(U + 0.2) > array.resolution_cell
    assert image[away].max() < 0.3 * image[~away].max()
