"""The views of IAA and of LIKES: their sums written out, a lone target's lobe, echoes that add with their phases."""

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, IRREGULAR, U, echoes, noise, some_rows

from shared.processes.defaults import TRUTH_WINDOW
from shared.signal.adaptive import PRIOR_EXPONENT
from shared.signal.windows import angle_window
from trainer.estimators.adaptive import (
    ELEMENTS,
    FLOOR,
    SHARP_ITERATIONS,
    VIEW_ITERATIONS,
    Prior,
    VirtualView,
    over_period,
)
from trainer.estimators.array import LineArray, scan_axis


def line_response(u: float, towards: NDArray[np.floating]) -> NDArray[np.complex128]:
    """[U] what 256 elements half a wavelength apart, with their window, see of an echo from u, element by element."""
    weights = angle_window(TRUTH_WINDOW, ELEMENTS) / ELEMENTS
    offsets = np.arange(ELEMENTS) - 127.5
    return np.asarray(
        sum(w * np.exp(1j * np.pi * n * (towards - u)) for w, n in zip(weights, offsets, strict=True)),
        dtype=np.complex128,
    )


def slow_view(
    x: NDArray[np.complex128],
    array: LineArray,
    u: NDArray[np.float64],
    noise_power: float,
    iterations: tuple[int, int] = (VIEW_ITERATIONS, 0),
    prior: Prior | None = None,
) -> NDArray[np.float64]:
    """[U] of one snapshot [C]: the class's formula, one angle at a time, whole covariances."""
    scan, _ = scan_axis(array, u)
    columns = array.manifold(scan).T
    identity = np.eye(array.channels)

    def covariance(power: NDArray[np.float64]) -> NDArray[np.complex128]:
        return np.asarray(sum(p * np.outer(a, a.conj()) for p, a in zip(power, columns, strict=True)))

    power = np.array([abs(np.vdot(a, x)) ** 2 for a in columns]) / array.channels**2
    weight = np.ones(len(scan)) if prior is None else prior(scan)[0]
    for _ in range(iterations[0]):
        full = covariance(power)
        inverse = np.linalg.inv(full + FLOOR * full[0, 0].real * identity)
        power = np.array([abs(np.vdot(a, inverse @ x) / np.vdot(a, inverse @ a).real) ** 2 for a in columns]) * weight
    for step in range(iterations[1] + 1):
        full = covariance(power)
        inverse = np.linalg.inv(full + max(noise_power, FLOOR * full[0, 0].real) * identity)
        if step < iterations[1]:
            ratio = np.array([abs(np.vdot(a, inverse @ x)) ** 2 / np.vdot(a, inverse @ a).real for a in columns])
            power = power * ratio * weight**PRIOR_EXPONENT
    image = np.zeros(len(u), dtype=np.complex128)
    for angle, p, a in zip(scan, power, columns, strict=True):
        image += p * np.vdot(a, inverse @ x) * line_response(angle, u)
    return np.abs(image)


@pytest.mark.parametrize("array", [ARRAYS["sparse4"], ARRAYS["sparse6"], IRREGULAR], ids=["sparse4", "sparse6", "odd"])
@pytest.mark.parametrize("noise_power", [0.0, 1.0])
def test_it_equals_its_sum_written_out(array: LineArray, noise_power: float) -> None:
    u = U[::45]
    rows = some_rows(array, rows=1)
    image = VirtualView().image(rows, array, u, noise_power)
    np.testing.assert_allclose(image[0], slow_view(rows[0], array, u, noise_power), rtol=1e-5, atol=1e-7)
    for prior in (None, lambda axis: 0.1 + 0.9 * np.exp(-((axis - 0.3) ** 2) / 0.02)[None]):
        sharp = VirtualView(sharp=True, told=True).image(rows, array, u, noise_power, prior)
        expected = slow_view(rows[0], array, u, noise_power, SHARP_ITERATIONS, prior)
        np.testing.assert_allclose(sharp[0], expected, rtol=1e-5, atol=1e-7)


def test_a_flat_prior_changes_no_bit_and_one_that_is_not_used_none_either() -> None:
    array, rows = ARRAYS["sparse6"], some_rows(ARRAYS["sparse6"], rows=70)
    plain = VirtualView(sharp=True).image(rows, array, U[::9], 1e-3)
    flat = VirtualView(sharp=True, told=True).image(rows, array, U[::9], 1e-3, lambda axis: np.ones((70, len(axis))))
    np.testing.assert_array_equal(flat, plain)
    unused = VirtualView(sharp=True).image(rows, array, U[::9], 1e-3, lambda axis: np.full((70, len(axis)), 0.5))
    np.testing.assert_array_equal(unused, plain)


def test_each_row_has_its_own_prior() -> None:
    """Lobes of three far elements, told apart by the prior alone; the row of zeros between is left out."""
    array = LineArray(np.array([0.0, 7.9e-3, 16.3e-3]), ARRAYS["full"].wavelength_m)
    x = np.ones((3, 3), dtype=complex)
    x[1] = 0.0

    def prior(axis: NDArray[np.float64]) -> NDArray[np.float64]:
        sides = np.stack([axis < 0.0, axis < 0.0, axis > 0.0])
        return np.where(sides & (np.abs(axis) > 0.1), 1.0, 0.1)

    image = VirtualView(sharp=True, told=True).image(x, array, U, 1e-3, prior)
    left, right = U < -0.1, U > 0.1
    assert image[0, left].max() > 3.0 * image[0, right].max()
    assert image[2, right].max() > 3.0 * image[2, left].max()


def test_of_angles_that_the_array_takes_for_one_the_likeliest_counts() -> None:
    """Two elements 8 mm apart see u and u + 0.4835 alike, and are scanned over |u| < 0.2418."""
    array = LineArray(np.array([0.0, 8e-3]), ARRAYS["full"].wavelength_m)
    axis, _ = scan_axis(array, U)
    assert np.abs(axis).max() <= 0.2418

    def prior(u: NDArray[np.float64]) -> NDArray[np.float64]:
        weight = np.where(np.abs(u - 0.7) < 0.05, 1.0, 0.1)
        return (weight / weight.max())[None]

    seen = over_period(prior, array, axis)
    near = np.abs(axis - (0.7 - 0.4835)) < 0.049
    assert (seen[0, near] == 1.0).all()
    assert (seen[0, np.abs(axis - (0.7 - 0.4835)) > 0.051] == 0.1).sum() > 0.5 * len(axis)


@pytest.mark.parametrize(("array", "share"), [("full", 0.99), ("sparse6", 0.98), ("sparse4", 0.95)])
def test_a_strong_target_is_as_the_line_sees_it(array: str, share: float) -> None:
    """Amplitude and main lobe are the line's, an eighth as wide as this array's; nothing else reaches -30 dB.

    IAA leaves some of the power in the bins beside the target, so that the lobe is a little lower and wider.
    """
    line, place, amplitude = ARRAYS[array], 322, 2.5 * np.exp(0.4j)
    generator = np.random.default_rng(5)
    x = echoes(line, U[None, place : place + 1], np.array([[amplitude]])) + noise(line, 1, 1e-6, generator)
    image = VirtualView().image(x, line, U, 1e-6)[0] / abs(amplitude)
    lobe = np.abs(line_response(U[place], U))
    assert image.argmax() == place
    assert share < image[place] < 1.0 + 2e-3
    np.testing.assert_allclose(image, lobe, atol=0.05)
    assert image[np.abs(U - U[place]) > 0.03].max() < 10.0 ** (-30.0 / 20.0)
    assert (image > np.sqrt(0.5)).sum() == (lobe > np.sqrt(0.5)).sum()


def test_echoes_add_with_their_phases() -> None:
    """Two targets in one lobe of the line, of equal and of opposite sign; the array cannot separate them."""
    array = ARRAYS["full"]
    u = np.array([[0.1, 0.1 + 0.4 / ELEMENTS]])
    same, opposite = (VirtualView().image(echoes(array, u, np.array([[1.0, s]])), array, U, 0.0)[0] for s in (1, -1))
    assert 1.8 < same.max() < 2.0
    assert opposite.max() < 0.2 * same.max()
