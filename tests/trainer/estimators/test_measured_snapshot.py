"""A measured snapshot of two reflectors, where the reference material lies beside the checkout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import half_wavelength_line
from scipy.io import loadmat

from trainer.estimators.base import ESTIMATORS
from trainer.estimators.das import DelayAndSum
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.music import Music
from trainer.metrics.peaks import strongest_peaks

MEASURED = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "measured" / "two_reflectors"


@pytest.fixture(scope="module")
def snapshot() -> NDArray[np.complex128]:
    path = MEASURED / "realData_demo.mat"
    if not path.is_file():
        pytest.skip("no reference material beside the checkout")
    # Their phase turns the other way.
    return loadmat(path)["bv_final"].conj()


def degrees(u: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.rad2deg(np.arcsin(u))


def test_two_real_reflectors(snapshot: NDArray[np.complex128]) -> None:
    u = np.sin(np.deg2rad(np.arange(-60.0, 60.0, 0.02)))
    likelihood, _ = MaximumLikelihood(2).locate(snapshot, half_wavelength_line(86))
    np.testing.assert_allclose(degrees(likelihood), [[-0.006, 6.985]], atol=5e-3)
    das = DelayAndSum().image(snapshot[:, :48], half_wavelength_line(48), u, 0.0)
    np.testing.assert_allclose(degrees(strongest_peaks(das, u, 2)), [[-0.08, 7.00]], atol=0.02)
    few = half_wavelength_line(10)
    das = DelayAndSum().image(snapshot[:, :10], few, u, 0.0)
    assert degrees(strongest_peaks(das, u, 1))[0, 0] == pytest.approx(3.3, abs=0.1)
    smoothed = Music("forward-backward", targets=2).image(snapshot[:, :10], few, u, 0.0)
    np.testing.assert_allclose(degrees(strongest_peaks(smoothed, u, 2)), [[-0.16, 6.68]], atol=0.02)


@pytest.mark.parametrize("name", ["iaa", "spice", "likes", "ml", "omp-cfar"])
def test_ten_elements_are_enough_for_the_serious_ones(name: str, snapshot: NDArray[np.complex128]) -> None:
    u = np.sin(np.deg2rad(np.arange(-60.0, 60.0, 0.05)))
    image = ESTIMATORS[name]().image(snapshot[:, :10], half_wavelength_line(10), u, 1e-6)
    np.testing.assert_allclose(degrees(strongest_peaks(image, u, 2)), [[0.0, 7.0]], atol=1.2)
