"""Probability of resolving two targets, and angular errors against the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from shared.physics.errors import InputError
from trainer.estimators.array import LineArray
from trainer.estimators.base import Estimator
from trainer.estimators.ml import MaximumLikelihood
from trainer.metrics.bootstrap import Interval, wilson
from trainer.metrics.bounds import deterministic_bound
from trainer.metrics.scenarios import Pair, Trials, draw_pairs

Locator = Callable[[NDArray[np.complexfloating], LineArray, float], NDArray[np.float64]]
"""(snapshots [T, C], array, noise power) to the angles found [T, K], rising, NaN where fewer were found."""

SEPARATIONS, SNRS_DB = (1.0, 0.5, 0.25), (10.0, 20.0, 30.0)


@dataclass(frozen=True)
class Resolution:
    """One cell of a table of resolution.

    :param probability: of resolving the pair, with its Wilson interval
    """

    method: str
    array: str
    pair: Pair
    trials: int
    probability: Interval


def strongest_peaks(image: NDArray[np.floating], u: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """[R, count] angles of the largest local maxima of each row of an image [R, U], rising; NaN for those missing."""
    found = np.full((len(image), count), np.nan)
    for row, spectrum in enumerate(image):
        peaks, _ = find_peaks(spectrum)
        best = peaks[np.argsort(spectrum[peaks], kind="stable")[::-1][:count]]
        found[row, : len(best)] = np.sort(np.asarray(u)[best])
    return found


def peak_locator(estimator: Estimator, u: NDArray[np.floating], count: int = 2) -> Locator:
    """The peak rule for images: the ``count`` largest local maxima of the image at the angles u, no interpolation."""
    return lambda snapshots, array, noise_power: strongest_peaks(
        estimator.image(snapshots, array, u, noise_power), u, count
    )


def likelihood_locator(count: int = 2) -> Locator:
    """The ceiling: maximum likelihood that knows how many targets there are."""
    estimator = MaximumLikelihood(count)
    return lambda snapshots, array, _noise_power: estimator.locate(snapshots, array)[0]


def resolved(found: NDArray[np.floating], true: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[T] whether both errors are below half the separation; found and true are [T, 2], both rising.

    :raises InputError: not two angles each
    """
    if np.shape(found) != np.shape(true) or np.ndim(true) != 2 or np.shape(true)[1] != 2:
        raise InputError("resolution", f"shapes {np.shape(found)} and {np.shape(true)}", "[trials, 2] both")
    half = 0.5 * (true[:, 1] - true[:, 0])
    # NaN, a target not found, compares false.
    return np.all(np.abs(found - true) < half[:, None], axis=1)


def resolution_table(
    methods: Mapping[str, Locator],
    arrays: Mapping[str, LineArray],
    separations: Sequence[float] = SEPARATIONS,
    snrs_db: Sequence[float] = SNRS_DB,
    ratios_db: Sequence[float] = (0.0,),
    phases_rad: Sequence[float | None] = (None,),
    trials: int = 200,
    seed: int = 0,
) -> Iterator[Resolution]:
    """Probability of resolution over methods x arrays x separation x SNR x amplitude ratio x phase, one cell at a time.

    The trials of a cell are the same for all methods, and their pairs the same for all cells and arrays.
    Separations are in resolution cells lambda / (span + spacing) of each array.

    :param methods: locators, see :func:`peak_locator` and :func:`likelihood_locator`
    """
    pairs = [
        Pair(separation, snr, ratio, phase)
        for separation in separations
        for snr in snrs_db
        for ratio in ratios_db
        for phase in phases_rad
    ]
    for array_name, array in arrays.items():
        for pair in pairs:
            drawn = draw_pairs(array, pair, trials, seed)
            for name, locate in methods.items():
                found = locate(drawn.snapshots, array, drawn.noise_power)
                successes = int(resolved(found, drawn.u).sum())
                yield Resolution(name, array_name, pair, trials, wilson(successes, trials))


@dataclass(frozen=True)
class Accuracy:
    """Angular errors of the trials in which all targets were found.

    :param found: share of the trials in which as many angles were found as there are targets
    :param bias: mean error in u
    :param rmse: root mean square error in u
    :param bound: root of the mean Cramer-Rao variance of the same trials
    """

    found: float
    bias: float
    rmse: float
    bound: float

    @property
    def ratio(self) -> float:
        """RMSE over the bound: 1 is efficient, less only by bias or prior knowledge."""
        return self.rmse / self.bound


def angular_accuracy(found: NDArray[np.floating], trials: Trials, array: LineArray) -> Accuracy:
    """Bias and RMSE of angles [T, K], rising, against the deterministic bound of each trial.

    :raises InputError: angles of another shape, or no trial in which all targets were found
    """
    if np.shape(found) != trials.u.shape:
        raise InputError("accuracy", f"angles of shape {np.shape(found)}", f"{trials.u.shape}")
    complete = np.flatnonzero(np.isfinite(found).all(axis=1))
    if not len(complete):
        raise InputError("accuracy", "no trial in which all targets were found", "at least one")
    errors = found[complete] - trials.u[complete]
    variances = [
        np.diag(deterministic_bound(array, trials.u[t], np.outer(s, s.conj()), trials.noise_power))
        for t, s in zip(complete, trials.amplitudes[complete], strict=True)
    ]
    return Accuracy(
        found=len(complete) / len(found),
        bias=float(errors.mean()),
        rmse=float(np.sqrt(np.mean(errors**2))),
        bound=float(np.sqrt(np.mean(variances))),
    )
