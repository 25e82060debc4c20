"""What the peaks of an image explain of the data, against the same row by row."""

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR, U, echoes, lines_image, noise
from scipy.signal import find_peaks

from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.lines import refine_lines
from trainer.metrics.residual import (
    REFINEMENTS,
    SUPPORT_PROBABILITY,
    Explanation,
    explain,
    image_lines,
    supported_lines,
)

BINS = len(U)


def slow_lines(row: NDArray[np.float64], level: float) -> NDArray[np.intp]:
    """Bins of the peaks of one row, strongest first, a zero added at either end."""
    top = float(row.max(initial=0.0))
    if not top > 0.0:
        return np.empty(0, dtype=np.intp)
    peaks = find_peaks(np.pad(row / top, 1), height=level, prominence=level)[0] - 1
    return peaks[np.argsort(row[peaks], kind="stable")[::-1]]


def slow_supported(manifold: NDArray[np.complex128], x: NDArray[np.complex128], threshold: float) -> int:
    """Lines of one row that remain, by the energies that least squares with and without each of them leave."""

    def left(columns: NDArray[np.complex128]) -> float:
        basis, _ = np.linalg.qr(columns)
        return float(np.sum(np.abs(x - basis @ (basis.conj().T @ x)) ** 2))

    kept = manifold
    while kept.shape[1]:
        saved = [left(np.delete(kept, line, axis=1)) - left(kept) for line in range(kept.shape[1])]
        weakest = int(np.argmin(saved))
        if saved[weakest] >= threshold:
            break
        kept = np.delete(kept, weakest, axis=1)
    return kept.shape[1]


@pytest.mark.parametrize("array", ["full", "sparse6", "sparse4"])
@pytest.mark.parametrize("method", ["das", "iaa"])
def test_an_image_at_once_is_its_rows_one_by_one(array: str, method: str) -> None:
    """Rows of three targets and of noise, imaged with their sidelobes: up to half the channels' lines in a row."""
    line, power, most = ARRAYS[array], 1e-3, ARRAYS[array].channels // 2
    generator = np.random.default_rng(3)
    strengths = np.exp(2j * np.pi * generator.random((24, 3))) * 10.0 ** generator.uniform(-1.5, 0.0, (24, 3))
    strengths[:4] = 0.0
    rows = echoes(line, generator.uniform(-0.8, 0.8, (24, 3)), strengths) + noise(line, 24, power, generator)
    image = ESTIMATORS[method]().image(rows, line, U, power)
    result = explain(image, U, rows, line, power)
    tested = unsupported = 0
    left = 0.0
    half_bin = 0.5 * RADAR.grid.step
    for row, x in zip(image, rows, strict=True):
        bins = slow_lines(row, 0.1)
        start = U[None, bins[:most]]
        angles = np.clip(refine_lines(x[None], start, line, REFINEMENTS), start - half_bin, start + half_bin)[0]
        manifold = line.manifold(angles)
        basis, _ = np.linalg.qr(manifold)
        left += float(np.sum(np.abs(x - basis @ (basis.conj().T @ x)) ** 2))
        tested += len(angles)
        unsupported += len(angles) - slow_supported(manifold, x, -power * float(np.log(SUPPORT_PROBABILITY)))
    assert (result.lines, result.unsupported) == (tested, unsupported)
    assert result.left == pytest.approx(left, rel=1e-9)
    assert 0 < unsupported < tested


def test_of_two_lines_at_one_angle_one_goes_and_of_none_none() -> None:
    line = ARRAYS["sparse6"]
    x = echoes(line, np.array([[0.1, 0.4]]), np.array([[1.0, 0.5j]]))
    threshold = np.array([1e-3])
    assert supported_lines(x, np.array([[0.1, 0.4, 0.1]]), line, threshold).tolist() == [2]
    assert supported_lines(x, np.array([[0.1, 0.4, 0.1 + 1e-9]]), line, threshold).tolist() == [2]
    assert supported_lines(x, np.empty((1, 0)), line, threshold).tolist() == [0]
    assert supported_lines(x, np.array([[0.1, 0.4]]), line, np.array([np.inf])).tolist() == [0]


def known_rows(array: LineArray) -> tuple[NDArray[np.complex128], list[list[int]]]:
    generator = np.random.default_rng(5)
    places = [[100, 300], [220], [60, 225, 400], [30]]
    u = np.zeros((4, 3))
    strengths = np.zeros((4, 3), dtype=complex)
    for row, bins in enumerate(places):
        u[row, : len(bins)] = U[bins]
        strengths[row, : len(bins)] = np.exp(2j * np.pi * generator.random(len(bins)))
    return echoes(array, u, strengths) + noise(array, 4, 1e-3, generator), places


@pytest.mark.parametrize("array", ["full", "sparse6", "sparse4"])
def test_the_true_image_explains_the_data(array: str) -> None:
    line = ARRAYS[array]
    rows, places = known_rows(line)
    result = explain(lines_image(places), U, rows, line, 1e-3)
    assert (result.rows, result.explained_rows, result.lines, result.unsupported) == (4, 4, 7, 0)
    assert result.left < 2e-3 * result.energy
    assert result.left == pytest.approx(1e-3 * (4 * line.channels - 7), rel=0.5)


def test_an_empty_image_explains_nothing() -> None:
    line = ARRAYS["sparse6"]
    rows, places = known_rows(line)
    result = explain(np.zeros((4, BINS)), U, rows, line, 1e-3)
    assert result.left == pytest.approx(result.energy)
    assert (result.explained_rows, result.lines) == (0, 0)
    silent = explain(lines_image(places), U, np.zeros_like(rows), line, 1e-3)
    assert silent == Explanation(0, 0, 0, 0, 0.0, 0.0)


@pytest.mark.parametrize("array", ["full", "sparse6"])
def test_rows_of_the_strongest_doppler_cell_of_noise_are_explained_by_nothing(array: str) -> None:
    """By the magnitudes of all channels, as datasets choose it; of one cell alone the tests would say otherwise."""
    line, whole, chirps, generator = ARRAYS[array], ARRAYS["full"], 64, np.random.default_rng(8)
    cells = noise(whole, 600 * chirps, 1.0, generator).reshape(600, chirps, whole.channels)
    strongest = np.abs(cells).mean(axis=2).argmax(axis=1)
    places = np.abs(whole.positions_m[:, None] - line.positions_m).argmin(axis=0)
    rows = cells[np.arange(600), strongest][:, places]
    image = ESTIMATORS["das"]().image(rows, line, U, 1.0)
    highest = lines_image([[int(top)] for top in image.argmax(axis=1)])
    told, untold = (explain(highest, U, rows, line, 1.0, of) for of in (chirps, 1))
    assert told.lines - told.unsupported <= 6
    assert untold.lines - untold.unsupported > 30
    empty = np.zeros((600, BINS))
    assert explain(empty, U, rows, line, 1.0, chirps).explained_rows >= 588
    assert explain(empty, U, rows, line, 1.0).explained_rows < 540


def test_invented_and_missing_targets_are_told_apart() -> None:
    line = ARRAYS["sparse6"]
    rows, places = known_rows(line)
    invented = [[*bins, 350] for bins in places]
    result = explain(lines_image(invented), U, rows, line, 1e-3)
    assert (result.lines, result.unsupported, result.explained_rows) == (11, 4, 4)
    missing = explain(lines_image([bins[:1] for bins in places]), U, rows, line, 1e-3)
    assert (missing.unsupported, missing.explained_rows) == (0, 2)
    assert missing.left / missing.energy == pytest.approx(3 / 7, abs=0.1)


def test_a_target_between_two_bins_is_explained_by_either() -> None:
    line, power = ARRAYS["full"], 1e-4
    u = np.array([[U[200] + 0.45 * RADAR.grid.step, U[300] - 0.3 * RADAR.grid.step]])
    rows = echoes(line, u, np.ones((1, 2), dtype=complex)) + noise(line, 1, power, np.random.default_rng(0))
    assert explain(lines_image([[200, 300]]), U, rows, line, power).explained_rows == 1
    # A bin too far is one: at 40 dB that cannot be the target.
    assert explain(lines_image([[198, 300]]), U, rows, line, power).explained_rows == 0


def test_peaks_in_noise_are_supported_as_rarely_as_said() -> None:
    line, rows = ARRAYS["sparse6"], 1500
    x = noise(line, rows, 1.0, np.random.default_rng(2))
    image = np.tile(lines_image([[225]]), (rows, 1))
    result = explain(image, U, x, line, 1.0)
    assert result.lines - result.unsupported <= 3 + 10 * rows * SUPPORT_PROBABILITY
    # And one line takes one of 18 dimensions.
    assert result.left / result.energy == pytest.approx(17 / 18, rel=0.01)
    assert result.explained_rows / rows == pytest.approx(0.99, abs=0.01)


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_the_residual_does_not_depend_on_the_unit(factor: float) -> None:
    line = ARRAYS["sparse6"]
    rows, places = known_rows(line)
    image = lines_image(places)
    one, scaled = explain(image, U, rows, line, 1e-3), explain(image, U, rows * factor, line, 1e-3 * factor**2)
    assert scaled.left / scaled.energy == pytest.approx(one.left / one.energy)
    assert (scaled.explained_rows, scaled.unsupported) == (one.explained_rows, one.unsupported)


def test_lines_include_the_ends_of_a_row_and_rows_do_not_know_each_other() -> None:
    image = np.zeros((3, 20))
    image[0, [0, 7, 19]] = [0.5, 1.0, 0.05]
    image[2, [0, 19]] = [1.0, 0.5]
    assert [bins.tolist() for bins in image_lines(image)] == [[7, 0], [], [0, 19]]
