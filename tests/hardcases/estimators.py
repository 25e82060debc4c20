"""Hard cases of the direction estimators: singular covariances, more targets than elements, noise alone, extremes.

Every estimator of ``trainer.estimators`` is asked; the worst of them is the measurement.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from hardcases.case import HardCase
from numpy.typing import NDArray

from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS, Estimator, line_array
from trainer.estimators.fitting import fit_lines

U = np.linspace(-0.85, 0.85, 171)
NOISE_W = 1e-4


def _arrays() -> dict[str, LineArray]:
    """The paper's arrays of 48, 18 and 12 virtual elements."""
    radar = Radar()
    return {name: line_array(radar, radar.array.channel_indices(rx)) for name, rx in AVR_QDM_110_THINNED_RX.items()}


SPARSE, FULL = _arrays()["sparse4"], _arrays()["full"]


def _asked(array: LineArray) -> Iterator[Estimator]:
    """Every estimator that takes this array, new."""
    makers = [*ESTIMATORS.values(), *(UNIFORM_ESTIMATORS.values() if array is FULL else ())]
    return (make() for make in makers)


def _noise(rows: int, channels: int) -> NDArray[np.complex128]:
    """[rows, channels] circular noise of NOISE_W."""
    generator = np.random.default_rng(11)
    return np.sqrt(NOISE_W / 2.0) * (generator.standard_normal((rows, channels, 2)) @ np.array([1.0, 1j]))


def _targets(array: LineArray, u: NDArray[np.float64]) -> NDArray[np.complex128]:
    """[C] snapshot of equal targets of unit amplitude and random phase, free of noise."""
    return array.manifold(u) @ np.exp(2j * np.pi * np.random.default_rng(12).uniform(size=len(u)))


def _not_finite(snapshots: NDArray, array: LineArray, noise_power: float) -> float:
    """Values of any estimator's image that are not finite, or below zero."""
    images = (estimator.image(snapshots, array, U, noise_power) for estimator in _asked(array))
    return float(sum(np.count_nonzero(~(np.isfinite(image) & (image >= 0.0))) for image in images))


def _zero_snapshots() -> float:
    """Values that are not zero for snapshots of zeros: a covariance of rank 0; a full row stands beside them."""
    wrong = 0.0
    for array in (SPARSE, FULL):
        snapshots = np.zeros((3, array.channels), dtype=np.complex128)
        snapshots[1] = _targets(array, np.array([0.2]))
        for noise_power in (0.0, NOISE_W):
            wrong += _not_finite(snapshots, array, noise_power)
            for estimator in _asked(array):
                wrong += np.count_nonzero(estimator.image(snapshots, array, U, noise_power)[[0, 2]])
    return wrong


def _rank_one() -> float:
    """Grid steps between a lone target free of noise and the peak that an estimator draws; AIC meets exact zeros."""
    worst = 0.0
    for array in (SPARSE, FULL):
        for column in (20, 85, 140):
            snapshot = _targets(array, U[[column]])[None]
            peaks = [int(estimator.image(snapshot, array, U, 0.0)[0].argmax()) for estimator in _asked(array)]
            worst = max(worst, *(abs(peak - column) for peak in peaks))
    return float(worst)


def _more_targets_than_elements() -> float:
    array = SPARSE
    crowd = np.stack([_targets(array, np.linspace(-0.8, 0.8, count)) for count in (12, 13, 40, 200)])
    return _not_finite(crowd, array, 0.0) + _not_finite(crowd, array, NOISE_W)


def _noise_alone() -> float:
    """Largest magnitude that an estimator draws in noise alone, over the noise's own in one channel.

    Maximum likelihood is told of two targets that are not there, whose best angles may all but coincide.
    """
    rows = 40
    worst = 0.0
    for array in (SPARSE, FULL):
        snapshots = _noise(rows, array.channels)
        if _not_finite(snapshots, array, NOISE_W):
            return np.inf
        images = (estimator.image(snapshots, array, U, NOISE_W) for estimator in _asked(array))
        worst = max(worst, *(float(image.max()) for image in images))
    return worst / float(np.sqrt(NOISE_W))


def _scaled(scale: float) -> float:
    """Relative error of the images of a snapshot at an extreme level, against the same at level 1."""
    worst = 0.0
    snapshots = _targets(SPARSE, np.array([-0.3, 0.4]))[None] + _noise(1, SPARSE.channels)
    for plain, extreme in zip(_asked(SPARSE), _asked(SPARSE), strict=True):
        image = plain.image(snapshots, SPARSE, U, NOISE_W)
        other = extreme.image(snapshots * scale, SPARSE, U, NOISE_W * scale**2) / scale
        largest = float(image.max())  # 0 where an estimator finds no target, and then must not at the other level
        worst = max(worst, float(np.abs(other - image).max()) / (largest or 1.0))
    return worst


def _elements_at_one_place() -> float:
    """Values not finite for an array with doubled elements, and for three in one place: singular manifolds."""
    arrays = [np.repeat(SPARSE.positions_m[:6], 2), np.zeros(3)]
    return sum(
        _not_finite(np.stack([_targets(array, np.array([0.1])), _noise(1, array.channels)[0]]), array, NOISE_W)
        for array in (LineArray(positions, SPARSE.wavelength_m) for positions in arrays)
    )


def _strong_beside_weak() -> float:
    """Values not finite where one target is 200 dB above another, and above the noise."""
    snapshot = _targets(SPARSE, np.array([0.1])) + 1e-10 * _targets(SPARSE, np.array([-0.5]))
    return _not_finite(snapshot[None], SPARSE, 0.0) + _not_finite(snapshot[None], SPARSE, 1e-20)


def _false_lines() -> float:
    """Lines that the fit finds in a frame of noise alone, 630 rows; the worse array, the mean of 10 frames."""
    frames, rows = 10, 630
    found = [
        fit_lines(_noise(frames * rows, array.channels), array, NOISE_W, np.full((frames * rows, 0), np.nan))
        for array in (SPARSE, FULL)
    ]
    return max(float(np.count_nonzero(lines.amplitude)) / frames for lines in found)


def _fitted_at_extremes() -> float:
    """Values of a line fit that are wrong: at zeros, without noise, without candidates, at extreme levels, at 80 dB."""
    wrong = 0
    lone = _targets(SPARSE, np.array([0.1]))
    rows: NDArray[np.complex128] = np.stack([np.zeros(SPARSE.channels), lone, lone, 1e4 * lone])
    rows[2:] += _noise(2, SPARSE.channels) / np.sqrt(NOISE_W) * np.array([[1e-1], [1.0]])
    for scale in (1e-20, 1.0, 1e20):
        for noise_power in (0.0, 0.01, 1.0):
            for start in (np.full((4, 0), np.nan), np.full((4, 2), 0.1), np.full((4, 3), [0.1003, 0.11, np.nan])):
                found = fit_lines(scale * rows, SPARSE, noise_power * scale**2, start)
                lines = np.count_nonzero(found.amplitude, axis=1)
                wrong += int(np.count_nonzero(~np.isfinite(found.amplitude))) + int(lines[0] != 0) + int(lines[3] != 1)
                wrong += int(abs(found.u[3, 0] - 0.1) > 1e-5) + int(abs(found.amplitude[3, 0] / scale / 1e4) > 1.001)
    return float(wrong)


CASES = (
    HardCase("estimators, zero snapshot", "the inverse of a zero covariance", 0.0, "wrong values", _zero_snapshots),
    HardCase("estimators, rank one, no noise", "AIC's logarithm of zero eigenvalues", 1.0, "grid steps", _rank_one),
    HardCase("more targets than elements", "no noise subspace", 0.0, "not finite", _more_targets_than_elements),
    HardCase("estimators on noise alone", "sparse solvers blow noise up", 3.0, "times the noise", _noise_alone),
    HardCase("estimators at 1e-20", "loadings and stops in absolute numbers", 1e-6, "relative", lambda: _scaled(1e-20)),
    HardCase("estimators at 1e20", "as above", 1e-6, "relative", lambda: _scaled(1e20)),
    HardCase("elements at one place", "a singular manifold", 0.0, "not finite", _elements_at_one_place),
    HardCase("line fit on noise alone", "noise is explained by lines", 1.0, "lines a frame", _false_lines),
    HardCase("line fit at extremes", "absolute thresholds, singular systems", 0.0, "wrong values", _fitted_at_extremes),
    HardCase("200 dB between targets", "a covariance of condition 1e40", 0.0, "not finite", _strong_beside_weak),
)
