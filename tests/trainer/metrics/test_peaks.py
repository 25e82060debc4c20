"""Peaks of a row and their bounds; images against the truth; intervals of what is averaged over frames."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR, U, deterministic_bound, echoes, half_wavelength_line, noise
from scipy.stats import bootstrap
from torchmetrics.functional.image import structural_similarity_index_measure

from shared.physics.errors import InputError
from shared.signal.windows import angle_window, width_and_sidelobe
from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS
from trainer.metrics import bootstrap as intervals
from trainer.metrics.bootstrap import bootstrap_mean, bootstrap_ratio, wilson
from trainer.metrics.cells import CellScores, average_precision, pooled
from trainer.metrics.image import nmse, nmse_best_scaled, ssim
from trainer.metrics.peaks import (
    false_alarms,
    noise_level,
    point_spread,
    resolved,
    single_source_bound,
    strongest_peaks,
)

VECTORS = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "vectors" / "doatools_vectors.json"


@pytest.mark.skipif(not VECTORS.is_file(), reason="no reference material beside the checkout")
def test_the_reference_bound_is_that_of_doatools() -> None:
    # Their manifold turns the other way: their angle theta is ours at -theta, and d theta = du / cos(theta).
    vectors = json.loads(VECTORS.read_text(encoding="utf-8"))
    angles = np.linspace(-np.pi / 3, np.pi / 4, 3)
    sources = np.array(vectors["P_re"]) + 1j * np.array(vectors["P_im"])
    found = deterministic_bound(half_wavelength_line(10), -np.sin(angles), sources, 1.0, 100)
    np.testing.assert_allclose(found / np.outer(np.cos(angles), np.cos(angles)), vectors["crb_det"], rtol=1e-6)


def test_the_bound_of_one_source_is_the_general_one_and_that_of_a_filled_line() -> None:
    for array in ARRAYS.values():
        general = deterministic_bound(array, np.array([0.3]), np.array([[1.0 + 0.0j]]), 0.01)
        assert general[0, 0] == pytest.approx(single_source_bound(array, 100.0), rel=1e-6, abs=0.0)
    # A filled line of length L has sum (p - mean p)^2 = C L^2 / 12, but for C^-2, and a cell lambda / L.
    full = ARRAYS["full"]
    expected = full.resolution_cell / (2.0 * np.pi) * np.sqrt(6.0 / (48 * 100.0))
    assert np.sqrt(single_source_bound(full, 100.0)) == pytest.approx(expected, rel=1e-3)


def test_random_angles_resolve_as_often_as_chance_says() -> None:
    separation = 0.4
    trials = 4000
    true = np.tile([[-separation / 2, separation / 2]], (trials, 1))
    found = np.sort(np.random.default_rng(0).uniform(-1.0, 1.0, (trials, 2)), axis=1)
    # Each angle must fall in its half of an interval of twice the separation: 2 (s / 2)^2.
    expected = 2.0 * (separation / 2.0) ** 2
    assert np.mean(resolved(found, true)) == pytest.approx(expected, abs=4.0 * np.sqrt(expected / trials))


def test_perfect_angles_resolve_and_an_empty_image_does_not() -> None:
    true = np.array([[-0.1, 0.1], [0.2, 0.25], [-0.5, -0.4]])
    assert resolved(true, true).all()
    assert not resolved(strongest_peaks(np.zeros((3, len(U))), U, 2), true).any()
    one = np.column_stack([true[:, 0], np.full(3, np.nan)])
    assert not resolved(one, true).any()
    # A single peak in the middle is not two.
    assert not resolved(np.repeat(true.mean(axis=1, keepdims=True), 2, axis=1), true).any()


def test_false_alarms_of_delay_and_sum_are_those_of_rice() -> None:
    array, rows, probability = ARRAYS["full"], 6000, 1e-3
    image = ESTIMATORS["das"]().image(noise(array, rows, 2.0, np.random.default_rng(1)), array, U, 2.0)
    level = noise_level(array, 2.0, probability)
    assert np.mean(image > level) == pytest.approx(probability, rel=0.15)
    beta = 2.0 * np.pi / array.wavelength_m * np.std(array.positions_m)
    expected = np.sqrt(-np.log(probability)) * beta * 1.7 / np.sqrt(np.pi) * probability
    assert false_alarms(image, level) / rows == pytest.approx(expected, rel=0.15)
    assert false_alarms(np.zeros((3, 50)), level) == 0


BINS = len(U)


def beam(array: LineArray, u_true: float, u: NDArray[np.float64] = U) -> NDArray[np.float64]:
    snapshot = echoes(array, np.array([[u_true]]), np.ones((1, 1), dtype=complex))
    return ESTIMATORS["das"]().image(snapshot, array, u, 0.0)[0]


@pytest.mark.parametrize(
    ("array", "bins", "sidelobe_db"), [("full", 9.5, -13.2), ("sparse6", 7.7, -5.4), ("sparse4", 6.9, -1.5)]
)
def test_point_spread_of_the_paper_arrays(array: str, bins: float, sidelobe_db: float) -> None:
    spread = point_spread(beam(ARRAYS[array], 0.1234), U)
    assert spread is not None
    assert spread.u == pytest.approx(0.1234, abs=2e-4)
    assert spread.width / RADAR.grid.step == pytest.approx(bins, abs=0.1)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.15)


def test_point_spread_of_a_window() -> None:
    weights = angle_window("taylor-30", 256)
    line = LineArray(0.5 * np.arange(256.0), 1.0)
    u = np.linspace(-0.2, 0.2, 801)
    row = np.abs(line.manifold(u).T @ weights) / 256
    spread = point_spread(row, u)
    assert spread is not None
    width, sidelobe_db = width_and_sidelobe(weights, 0.5)
    assert spread.width == pytest.approx(width, rel=0.01)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.3)


def test_integrated_sidelobes_of_a_filled_line() -> None:
    # A sinc has 90.3 % of its energy between its first zeros: -9.7 dB beside it.
    line = LineArray(0.5 * np.arange(200.0), 1.0)
    spread = point_spread(beam(line, 0.0, np.linspace(-1.0, 1.0, 4001)), np.linspace(-1.0, 1.0, 4001))
    assert spread is not None
    assert spread.islr_db == pytest.approx(10.0 * np.log10(0.0972 / 0.9028), abs=0.1)


def test_a_main_lobe_reaches_to_the_minima_on_both_sides() -> None:
    spread = point_spread(np.array([0.4, 0.2, 1.0, 0.6, 0.3, 0.5]), np.arange(6.0))
    assert spread is not None
    assert spread.islr_db == pytest.approx(10.0 * np.log10((0.16 + 0.25) / (0.04 + 1.0 + 0.36 + 0.09)))


def test_point_spread_of_lines_edges_and_nothing() -> None:
    line = np.zeros(50)
    line[20] = 3e-20
    spread = point_spread(line, U[:50])
    assert spread is not None
    assert spread.u == pytest.approx(U[20])
    assert spread.width < 1.5 * RADAR.grid.step
    assert spread.pslr_db == spread.islr_db == -np.inf
    edge = point_spread(np.linspace(0.0, 1.0, 50), U[:50])
    assert edge is not None
    assert edge.width == np.inf
    assert point_spread(np.zeros(50), U[:50]) is None


def test_image_metrics_of_perfect_and_empty_images() -> None:
    truth = np.random.default_rng(2).random((40, 60))
    empty = np.zeros_like(truth)
    assert nmse(truth, truth) == nmse_best_scaled(truth, truth) == 0.0
    assert nmse(empty, truth) == nmse_best_scaled(empty, truth) == 1.0
    assert nmse(3.0 * truth, truth) == pytest.approx(4.0)
    assert nmse_best_scaled(3.0 * truth, truth) == pytest.approx(0.0, abs=1e-12)
    assert ssim(truth, truth) == pytest.approx(1.0)
    assert ssim(empty, truth) < 0.02


def test_ssim_is_that_of_torchmetrics() -> None:
    generator = np.random.default_rng(0)
    truth = generator.random((30, 26))
    estimate = truth + 0.3 * generator.standard_normal(truth.shape)
    one, other = (torch.from_numpy(image)[None, None] for image in (estimate, truth))
    _, likeness = structural_similarity_index_measure(one, other, data_range=1.0, sigma=1.5, return_full_image=True)
    # Its mean includes pixels whose window hangs over the edge.
    assert ssim(estimate, truth) == pytest.approx(float(likeness[..., 5:-5, 5:-5].mean()), abs=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        lambda: nmse(np.zeros(3), np.zeros(4)), lambda: nmse(np.ones(3), np.zeros(3)),
        lambda: nmse(np.full(3, np.nan), np.ones(3)), lambda: ssim(np.ones((5, 50)), np.ones((5, 50))),
        lambda: nmse(np.empty(0), np.empty(0)),
    ],
)  # fmt: skip
def test_images_that_cannot_be_compared_are_refused(call) -> None:
    with pytest.raises(InputError, match="expected"):
        call()


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
