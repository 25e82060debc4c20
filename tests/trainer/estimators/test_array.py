"""The line of elements: spacing, period, the angles scanned, covariances by distances, lines drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_arrays import ARRAYS, IRREGULAR, RADAR, U

from shared.signal.adaptive import adaptive_forms, line_tables
from shared.signal.imaging import delay_and_sum
from trainer.data.arrays import choose_array
from trainer.estimators import array as array_module
from trainer.estimators.array import LineArray, draw_lines, line_array, scan_axis, uniform_axis
from trainer.estimators.baselines import DelayAndSum


@pytest.mark.parametrize("array", ARRAYS)
def test_delay_and_sum_is_that_of_the_images(array: str) -> None:
    choice = choose_array(array, RADAR)
    channels = choice.channels(RADAR)
    generator = np.random.default_rng(1)
    matrix = (generator.standard_normal((9, 48)) + 1j * generator.standard_normal((9, 48))).astype(np.complex64)
    expected = np.abs(delay_and_sum(matrix, RADAR, channels))
    image = DelayAndSum().image(matrix[:, channels], line_array(RADAR, channels), U, 0.0)
    np.testing.assert_allclose(image, expected, atol=2e-6)


def test_spacing_period_and_cell_of_the_paper_arrays() -> None:
    wavelength = RADAR.waveform.wavelength_m
    for array in ARRAYS.values():
        assert array.spacing_m == pytest.approx(2e-3)
        assert array.half_period == pytest.approx(wavelength / 4e-3)
        assert array.resolution_cell == pytest.approx(wavelength / 96e-3)
    assert [array.channels for array in ARRAYS.values()] == [48, 18, 12]


def test_elements_off_every_grid_have_no_period() -> None:
    assert IRREGULAR.spacing_m is None
    assert IRREGULAR.half_period == 1.0


@given(
    st.lists(st.integers(0, 60), min_size=2, max_size=10, unique=True), st.floats(0.5e-3, 4e-3), st.floats(-0.2, 0.2)
)
def test_elements_on_a_grid_are_found_to_be(steps: list[int], spacing: float, offset: float) -> None:
    # The true spacing is a part of the smallest gap down to the eighth; the divisor of all gaps is what repeats.
    divisor = np.gcd.reduce(np.diff(sorted(steps)))
    smallest = np.diff(sorted(steps)).min()
    if smallest // divisor > 8:
        return
    array = LineArray(offset + spacing * np.array(steps), 3.868e-3)
    assert array.spacing_m == pytest.approx(divisor * spacing, rel=1e-2)


def test_scan_covers_the_period_and_holds_what_is_shown() -> None:
    array = ARRAYS["sparse4"]
    scan, shown = scan_axis(array, U)
    np.testing.assert_allclose(scan[shown], U, atol=1e-12)
    ring = np.sort(np.append(scan, scan.min() + 2.0 * array.half_period))
    assert scan.min() >= -array.half_period - 1e-12
    assert np.diff(ring).max() <= 1.6 * array.resolution_cell / array_module.POINTS_PER_CELL


def test_scan_folds_angles_beyond_the_period() -> None:
    array = ARRAYS["sparse6"]
    beyond = np.array([-0.99, 0.0, 0.99])
    scan, shown = scan_axis(array, beyond)
    overlap = np.sum(array.manifold(scan[shown]).conj() * array.manifold(beyond), axis=0)
    np.testing.assert_allclose(np.abs(overlap), array.channels)
    assert np.abs(scan).max() <= array.half_period + 1e-12


@pytest.mark.parametrize("array", [ARRAYS["sparse6"], IRREGULAR, LineArray(np.array([0.0, 0.0, 2e-3]), 3.9e-3)])
def test_distances_stand_for_the_dense_covariance(array: LineArray) -> None:
    generator = np.random.default_rng(3)
    u = uniform_axis(array, 3)
    power, noise = generator.random((2, len(u))), np.array([0.1, 0.2])
    x = generator.standard_normal((2, array.channels)) + 1j * generator.standard_normal((2, array.channels))
    manifold = array.manifold(u)
    dense = np.einsum("bn,cn,dn->bcd", power, manifold, manifold.conj())
    inverse = np.linalg.inv(dense + noise[:, None, None] * np.eye(array.channels))
    filtered, form = adaptive_forms(power, x, noise, line_tables(array.positions_m, array.wavelength_m, u), 0.0, 0.0)
    np.testing.assert_allclose(filtered, np.einsum("cn,bcd,bd->bn", manifold.conj(), inverse, x), atol=1e-9)
    np.testing.assert_allclose(form, np.einsum("cn,bcd,dn->bn", manifold.conj(), inverse, manifold).real, atol=1e-9)


def test_lines_are_drawn_in_their_nearest_bin() -> None:
    array, u = ARRAYS["full"], np.array([-0.2, 0.0, 0.2])
    found = np.array([[-0.31, -0.29, 0.05, 0.11], [0.29, 0.31, -0.05, 0.04]])
    amplitude = np.array([[9.0, 1.0, 2.0, 0.0], [3.0, 9.0, 4.0, 5.0]])
    np.testing.assert_array_equal(draw_lines(found, amplitude, array, u), [[1.0, 2.0, 0.0], [0.0, 5.0, 3.0]])
    assert draw_lines(found[:, :0], amplitude[:, :0], array, u).shape == (2, 3)


@pytest.mark.parametrize("chosen", ["full", "sparse6"])
def test_ghosts_of_single_elements_are_those_of_drawn_errors(chosen: str) -> None:
    channels = choose_array(chosen, RADAR).channels(RADAR)
    array, generator, apart = line_array(RADAR, channels), np.random.default_rng(2), np.linspace(0.05, 1.5, 12)
    error = np.zeros((4000, 48), dtype=np.complex128)
    for element in (RADAR.array.channel_tx, RADAR.array.channel_rx):
        drawn = generator.standard_normal((4000, element.max() + 1, 2)) @ [0.5, 0.5j]
        error += drawn[:, element]
    np.testing.assert_allclose(np.mean(np.abs(error) ** 2), 1.0, rtol=0.05)
    line = error[:, channels] @ array.manifold(-apart) / array.channels
    np.testing.assert_allclose(array.ghost_share(apart), np.mean(np.abs(line) ** 2, axis=0), rtol=0.1)
    assert not LineArray(array.positions_m, array.wavelength_m).ghost_share(apart).any()
