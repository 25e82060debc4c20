"""Maximum likelihood, the amplitudes of its lines and their refinement."""

import numpy as np
import pytest
from paper_arrays import ARRAYS, echoes, noise, some_rows

from trainer.estimators.array import LineArray
from trainer.estimators.lines import SEPARABLE, bounded_amplitudes, line_amplitudes, refine_lines
from trainer.estimators.ml import MaximumLikelihood


def test_maximum_likelihood_is_exact_without_noise() -> None:
    array = ARRAYS["sparse6"]
    true = np.array([[-0.4, 0.11, 0.153], [-0.7, 0.0, 0.02]])
    strengths = np.array([[1.0, 0.3j, -1.0], [0.5, 1.0j, 1.0]])
    rows = echoes(array, true, strengths)
    found, amplitude = MaximumLikelihood(3).locate(rows, array)
    np.testing.assert_allclose(found, true, atol=1e-6)
    np.testing.assert_allclose(amplitude, strengths, atol=1e-4)
    pair, _ = MaximumLikelihood().locate(echoes(array, true[:, 1:], strengths[:, 1:]), array)
    np.testing.assert_allclose(pair, true[:, 1:], atol=1e-6)


def test_no_pair_explains_more_than_the_maximum_likelihood_pair() -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=30, targets=4, noise_power=0.3)
    found, _ = MaximumLikelihood(2).locate(rows, array)
    left = np.linalg.norm(line_amplitudes(rows, found, array)[1], axis=1)
    generator = np.random.default_rng(0)
    for _ in range(40):
        start = generator.uniform(-array.half_period, array.half_period, (30, 2))
        other = np.linalg.norm(line_amplitudes(rows, refine_lines(rows, start, array), array)[1], axis=1)
        assert (left <= other * (1.0 + 1e-6)).all()


def test_locate_leaves_empty_rows_at_zero() -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=3)
    rows[1] = 0.0
    found, amplitude = MaximumLikelihood().locate(rows, array)
    assert not found[1].any()
    assert not amplitude[1].any()
    assert np.abs(amplitude[[0, 2]]).min() > 0.0
    assert (np.diff(found) >= 0.0).all()


@pytest.mark.parametrize("array", ["full", "sparse6", "sparse4"])
def test_lines_in_noise_do_not_cancel_each_other(array: str) -> None:
    """Two angles told of, none there: unbounded least squares reaches a thousand times the noise."""
    line = ARRAYS[array]
    rows = noise(line, 300, 1.0, np.random.default_rng(0))
    found, amplitude = MaximumLikelihood().locate(rows, line)
    # At most what any unit combination of channels has in it, over the least singular value kept.
    limit = np.linalg.norm(rows, axis=1) / np.sqrt(SEPARABLE * line.channels)
    assert (np.abs(amplitude).max(axis=1) <= limit).all()
    assert np.abs(amplitude).max() < 3.0
    if array == "full":
        assert np.abs(line_amplitudes(rows, found, line)[0]).max() > 100.0


def test_bounded_amplitudes_are_those_of_least_squares_until_lines_all_but_coincide() -> None:
    array = ARRAYS["sparse6"]
    generator = np.random.default_rng(1)
    apart = np.array([[0.1, 0.1 + 0.5 * array.resolution_cell, 0.4]])
    x = echoes(array, apart, np.array([[1.0, 0.5j, -0.2]])) + noise(array, 1, 0.01, generator)
    for bounded, plain in zip(bounded_amplitudes(x, apart, array), line_amplitudes(x, apart, array), strict=True):
        np.testing.assert_allclose(bounded, plain, atol=1e-9)
    # The sum of what stands there, halved; nothing where they cancel.
    close = np.array([[0.1, 0.1 + 1e-4 * array.resolution_cell]])
    same = echoes(array, close, np.array([[0.7 + 0j, 0.3]]))
    np.testing.assert_allclose(bounded_amplitudes(same, close, array)[0], [[0.5, 0.5]], atol=1e-3)
    opposite = echoes(array, close, np.array([[501.0 + 0j, -500.0]]))
    amplitude, left = bounded_amplitudes(opposite, close, array)
    np.testing.assert_allclose(np.abs(amplitude), 0.5, atol=0.2)
    np.testing.assert_allclose(left, opposite - echoes(array, close, amplitude))


def test_refinement_never_makes_it_worse() -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array, rows=40, noise_power=0.1)
    start = np.random.default_rng(1).uniform(-0.9, 0.9, (40, 3))
    start[0] = 0.2  # three lines at one angle
    before = np.linalg.norm(line_amplitudes(rows, start, array)[1], axis=1)
    after = np.linalg.norm(line_amplitudes(rows, refine_lines(rows, start, array), array)[1], axis=1)
    assert (after <= before * (1.0 + 1e-9)).all()
    assert after.mean() < 0.95 * before.mean()


@pytest.mark.parametrize(("name", "targets"), [("sparse6", 3), ("sparse4", 3), ("sparse6", 4)])
def test_three_and_four_targets_end_no_worse_than_a_refinement_from_the_truth(name: str, targets: int) -> None:
    """Neighbours 0.25 to 3 cells apart, equal levels, 10 to 30 dB: less than one in a hundred."""
    array, cell, rows = ARRAYS[name], ARRAYS["full"].resolution_cell, 300 if targets == 3 else 60
    generator = np.random.default_rng(11)
    gaps = cell * generator.uniform(0.25, 3.0, (rows, targets - 1))
    true = np.cumsum(np.concatenate([generator.uniform(-0.4, 0.4, (rows, 1)), gaps], axis=1), axis=1)
    level = 10.0 ** (-generator.uniform(10.0, 30.0, (rows, 1)) / 20.0)
    x = echoes(array, true, np.exp(2j * np.pi * generator.random(true.shape))) + level * noise(
        array, rows, 1.0, generator
    )
    found, _ = MaximumLikelihood(targets).locate(x, array)
    reference = line_amplitudes(x, refine_lines(x, true, array, 100), array)[1]
    left = line_amplitudes(x, found, array)[1]
    worse = np.linalg.norm(left, axis=1) > np.linalg.norm(reference, axis=1) * (1.0 + 1e-4)
    assert worse.mean() < 0.01


@pytest.mark.parametrize("positions", [[0.0, 2e-3, 5e-3, 6e-3], [0.0, 0.0, 0.0, 0.0], [0.0, 3.1e-3, 7.7e-3, 9e-3]])
def test_many_lines_of_few_elements_are_found_or_shared(positions: list[float]) -> None:
    array = LineArray(np.array(positions), ARRAYS["full"].wavelength_m)
    found, amplitude = MaximumLikelihood(3).locate(np.ones((2, 4), dtype=complex), array)
    assert np.isfinite(found).all()
    assert np.isfinite(amplitude).all()
    assert MaximumLikelihood(3).locate(np.ones((0, 4), dtype=complex), array)[0].shape == (0, 3)
