"""The test of constant false-alarm rate that chooses the cells of ``--cells all``."""

import numpy as np
import pytest

from shared.physics.errors import InputError
from trainer.data.cfar import cfar_cells, cfar_factor, cfar_probability, os_cfar


@pytest.mark.parametrize("factor", [2.0, 10.0])
def test_of_one_channel_the_probability_is_rohlings_product(factor: float) -> None:
    cells, rank = 48, 24
    product = np.prod([(cells - i) / (cells - i + factor) for i in range(rank)])
    assert cfar_probability(factor, 1, cells, rank) == pytest.approx(product, rel=1e-6)


def windowed_noise(rows: int, chirps: int, channels: int, seed: int) -> np.ndarray:
    """[R, chirps, C] Hann windowed spectra of unit noise; the scale does not matter."""
    draw = np.random.default_rng(seed)
    noise = draw.standard_normal((chirps, rows, channels, 2)).view(np.complex128)[..., 0]
    fast, slow = (0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n) for n in (rows, chirps))
    return np.fft.fft2(noise * slow[:, None, None] * fast[:, None], axes=(0, 1)).swapaxes(0, 1)


@pytest.mark.parametrize("channels", [1, 6])
def test_noise_alone_passes_as_often_as_asked(channels: int) -> None:
    asked, cells, passed = 0.01, 0, 0
    for seed in range(8):
        power = np.sum(np.abs(windowed_noise(128, 64, channels, seed)) ** 2, axis=2)
        passed += int(os_cfar(power, channels, asked).sum())
        cells += power.size
    # Neighbours pass together, some nine cells at most: five deviations of such clusters.
    assert abs(passed - asked * cells) < 5.0 * np.sqrt(9.0 * asked * cells)


def test_cells_are_those_that_a_loop_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trainer.data.cfar.CELL_FALSE_ALARM", 0.01)
    spectra = windowed_noise(40, 32, 4, 3)
    spectra[20, 5], spectra[30, 31] = 60.0, 80.0
    power, alpha = np.sum(np.abs(spectra) ** 2, axis=2), cfar_factor(4, 48, 24, 0.01)
    expected = np.zeros(power.shape, bool)
    for row in range(40):
        for cell in range(32):
            around = [
                power[(row - i) % 40, (cell - j) % 32]
                for i in range(-9, 10, 3) for j in range(-9, 10, 3) if i or j
            ]  # fmt: skip
            expected[row, cell] = power[row, cell] > alpha * sorted(around)[23]
    np.testing.assert_array_equal(os_cfar(power, 4, 0.01), expected)
    selection, centre = cfar_cells(spectra)
    listed = {(int(r), int(selection.cells[d, r])) for d, r in zip(*np.nonzero(centre), strict=True)}
    rows, cells = np.nonzero(expected)
    left, right = power[rows, (cells - 1) % 32], power[rows, (cells + 1) % 32]
    top = (power[rows, cells] > left) & (power[rows, cells] >= right)
    assert listed == set(zip(rows[top].tolist(), cells[top].tolist(), strict=True))
    assert (20, 5) in listed
    # A centre's neighbours in range are there, to be fitted with it.
    assert all(5 in selection.cells[:, row] for row in (19, 20, 21))


def test_one_chirp_or_two_have_range_alone_and_too_few_cells_are_refused() -> None:
    for chirps in (1, 2):
        spectra = windowed_noise(64, chirps, 4, 0)
        spectra[30] = 50.0
        selection, centre = cfar_cells(spectra)
        assert selection.cells[0, 30] == chirps // 2  # at rest
        assert centre[:, 30].sum() == 1
    with pytest.raises(InputError, match="--cells"):
        os_cfar(np.ones((4, 4)), 1, 0.01)
