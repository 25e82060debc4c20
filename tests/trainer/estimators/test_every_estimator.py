"""What every estimator keeps to: place and amplitude of a lone target, units, shapes, finite numbers, refusals."""

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, IRREGULAR, RADAR, U, echoes, noise, some_rows

from shared.physics.errors import InputError
from trainer.estimators import array as array_module
from trainer.estimators.array import LineArray, NoisePower, check_snapshots
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS
from trainer.estimators.ml import MaximumLikelihood

AMPLITUDE_KEPT = {"spice": 0.6, "likes": 0.99, "iaa-view": 0.95, "likes-view": 0.95, "likes-view-ego": 0.95}
"""Share of the amplitude of a lone target that an estimator must show; the others show it all."""


@pytest.fixture(params=ESTIMATORS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.mark.parametrize("array", ARRAYS)
def test_a_lone_target_on_the_left_is_seen_there_at_its_amplitude(name: str, array: str) -> None:
    line = ARRAYS[array]
    place, amplitude = 322, 3e-6 * np.exp(0.4j)  # U[322] = 0.366
    snapshot = echoes(line, U[None, place : place + 1], np.array([[amplitude]]))
    estimator = MaximumLikelihood(1) if name == "ml" else ESTIMATORS[name]()
    image = estimator.image(snapshot, line, U, 1e-16)
    assert image.shape == (1, len(U))
    assert np.argmax(image[0]) == place
    shown = image[0, place] / abs(amplitude)
    if name in AMPLITUDE_KEPT:
        # The power may share out to the bins beside it.
        assert AMPLITUDE_KEPT[name] < shown <= 1.0 + 1e-6
    else:
        assert shown == pytest.approx(1.0, rel=2e-3)


def test_hard_rows_stay_finite(name: str) -> None:
    array = ARRAYS["sparse4"]
    generator = np.random.default_rng(2)
    crowd = echoes(array, generator.uniform(-0.8, 0.8, (1, 30)), np.ones((1, 30), dtype=complex))
    one_channel = np.zeros((1, 12), dtype=complex)
    one_channel[0, 4] = 1.0
    rows = np.concatenate(
        [np.zeros((1, 12)), np.ones((1, 12)), crowd, one_channel, noise(array, 2, 1.0, generator), some_rows(array, 2)]
    )
    for noise_power in (0.0, 1e-30, 1.0, 1e30):
        image = ESTIMATORS[name]().image(rows, array, U, noise_power)
        assert image.shape == (len(rows), len(U))
        assert np.isfinite(image).all()
        assert (image >= 0.0).all()
        assert not image[0].any()
    assert ESTIMATORS[name]().image(rows[:0], array, U, 1.0).shape == (0, len(U))


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_the_image_has_the_unit_of_the_snapshot(name: str, factor: float) -> None:
    array = ARRAYS["sparse6"]
    rows = some_rows(array)
    image = ESTIMATORS[name]().image(rows, array, U, 1e-3)
    scaled = ESTIMATORS[name]().image(rows * factor, array, U, 1e-3 * factor**2)
    np.testing.assert_allclose(scaled / factor, image, atol=1e-6 * image.max())
    stored = ESTIMATORS[name]().image((rows * factor).astype(np.complex64), array, U, 1e-3 * factor**2)
    assert np.isfinite(stored).all()


def test_any_line_of_elements_will_do(name: str) -> None:
    wavelength = RADAR.waveform.wavelength_m
    lines = [
        IRREGULAR,
        LineArray(np.array([0.0, 0.0, 2e-3, 6e-3]), wavelength),
        LineArray(np.array([0.0, 2e-3, 4e-3]), wavelength),
    ]
    for array in lines:
        image = ESTIMATORS[name]().image(some_rows(array), array, U, 1e-3)
        assert np.isfinite(image).all()
    alone = LineArray(np.array([1e-3]), wavelength)
    estimator = MaximumLikelihood(1) if name == "ml" else ESTIMATORS[name]()
    assert np.isfinite(estimator.image(np.array([[1.0 + 1.0j]]), alone, U, 1e-3)).all()


def test_rows_do_not_know_each_other(name: str) -> None:
    array = ARRAYS["sparse4"]
    rows = some_rows(array, rows=array_module.ROWS_AT_ONCE + 3)
    rows[5] = 0.0
    image = ESTIMATORS[name]().image(rows, array, U[::5], 1e-3)
    for row in (0, 6, array_module.ROWS_AT_ONCE - 1, array_module.ROWS_AT_ONCE + 2):
        alone = ESTIMATORS[name]().image(rows[row : row + 1], array, U[::5], 1e-3)
        np.testing.assert_allclose(image[row], alone[0], atol=1e-6 * image.max())


def test_every_row_has_its_own_noise(name: str) -> None:
    """Rows told their own noise do not know each other's; where it is one for all, one number says the same."""
    array = ARRAYS["sparse6"]
    rows, powers = some_rows(array), np.array([0.0, 1e-6, 1e-3, 0.1, 10.0])
    image = ESTIMATORS[name]().image(rows, array, U[::5], powers)
    for row, power in enumerate(powers):
        alone = ESTIMATORS[name]().image(rows[row : row + 1], array, U[::5], np.array([power]))
        np.testing.assert_allclose(image[row], alone[0], atol=1e-6 * image.max())
    equal = ESTIMATORS[name]().image(rows, array, U[::5], np.full(5, 1e-3))
    # Its noise is estimated, unless it is told that of each row.
    assert name == "omp-cfar" or (equal == ESTIMATORS[name]().image(rows, array, U[::5], 1e-3)).all()


@pytest.mark.parametrize(
    ("rows", "noise_power", "text"),
    [
        (np.zeros((2, 11)), 0.0, r"snapshots: shape \(2, 11\); expected \[range bins, 12 channels\]"),
        (np.array([np.ones(12), np.full(12, np.nan)]), 0.0, "1 rows not finite, the first is row 1"),
        (np.ones((2, 12)), -1.0, "noise_power: -1.0"),
        (np.ones((2, 12)), np.array([1.0, -2.0]), "noise_power: -2.0"),
        (np.ones((2, 12)), np.ones(3), r"noise_power: shape \(3,\); expected one power, or one for each of 2 rows"),
    ],
)
def test_bad_snapshots_are_refused_in_one_line(rows: NDArray, noise_power: NoisePower, text: str) -> None:
    with pytest.raises(InputError, match=text):
        ESTIMATORS["iaa"]().image(rows, ARRAYS["sparse4"], U, noise_power)


@pytest.mark.parametrize(
    "make",
    [
        lambda: LineArray(np.empty(0), 1.0),
        lambda: LineArray(np.array([np.nan]), 1.0), lambda: LineArray(np.zeros(2), 0.0),
        lambda: check_snapshots(np.zeros((1, 2), complex), IRREGULAR),
        lambda: MaximumLikelihood(6).locate(np.ones((1, 6), complex), IRREGULAR),
        lambda: UNIFORM_ESTIMATORS["music-fbss"]().image(np.ones((1, 12), complex), ARRAYS["sparse4"], U, 0.0),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make) -> None:
    with pytest.raises(InputError, match="expected"):
        make()
