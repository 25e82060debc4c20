"""The detections of a frame: lines fitted to every range bin and Doppler peak, one for each target.

A target stands in several range bins and Doppler cells: the Hann window's main lobe is four of either wide, and its
sidelobes begin at -31 dB. A line is a detection where no stronger line at its angle explains it so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db
from shared.radar import Radar
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import MODEL_ERROR_DB, fit_lines, score_peaks

CANDIDATES = 6
"""Peaks of a row's score that its fit begins with."""
SAME_ANGLE_CELLS = 0.5
"""Lines of neighbouring range bins at most so far apart, in resolution cells of the array, are one target's."""
LOBE_MARGIN_DB = 3.0
"""A line so far above what the window gives a stronger one there is a target of its own."""
LEAST_OFFSET = 1.5
"""Bins from a peak where the window's response has fallen and its envelope begins."""


@dataclass(frozen=True, eq=False)
class Detections:
    """N detections, the strongest first.

    :param range_m: [N] between two range bins where both neighbours show the target, else that of its bin [m]
    :param u: [N] sin(azimuth)
    :param velocity: [N] of the Doppler cell [m/s]
    :param amplitude_db: [N] of the line in its range-Doppler cell [dB re 1 sqrt(W)]
    :param u_std: [N] standard deviation of u by the Cramer-Rao bound
    :param probability: [N] of a target, by the network's detection head; NaN where it has none
    """

    range_m: NDArray[np.float64]
    u: NDArray[np.float64]
    velocity: NDArray[np.float64]
    amplitude_db: NDArray[np.float64]
    u_std: NDArray[np.float64]
    probability: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.u)


def find_detections(
    image: NDArray[np.floating],
    probability: NDArray[np.floating] | None,
    snapshots: NDArray[np.complexfloating],
    velocity: NDArray[np.floating],
    radar: Radar,
    array: LineArray,
    noise_power: float,
    model_error_db: float = MODEL_ERROR_DB,
) -> Detections:
    """The detections of one frame.

    :param image: [D, R, U] of each Doppler peak; the fit begins with the peaks of image * sqrt(probability)
    :param probability: [D, R, U] of a target, None for a network without a detection head
    :param snapshots: [D, R, C] the channels of ``array`` at each Doppler peak [sqrt(W)]
    :param velocity: [D, R] of those [m/s]; a peak that repeats an earlier one of its range bin is left out
    :param noise_power: of one channel and cell [W]
    :param model_error_db: see :func:`trainer.estimators.fitting.fit_lines`
    :raises InputError: shapes that do not fit
    """
    expected = (*np.shape(snapshots)[:2], radar.grid.bins)
    if np.shape(image) != expected or np.shape(velocity) != expected[:2]:
        raise InputError("detections", f"an image {np.shape(image)}, velocities {np.shape(velocity)}", f"{expected}")
    peak, row = np.nonzero(new_peaks(velocity))
    score = image[peak, row].astype(np.float64)
    if probability is not None:
        score *= np.sqrt(probability[peak, row])
    axis = radar.grid.u
    found = fit_lines(
        snapshots[peak, row], array, noise_power, score_peaks(score, axis, CANDIDATES), model_error_db=model_error_db
    )
    half_bin = 0.5 * radar.grid.step
    with np.errstate(invalid="ignore"):
        shown = (found.u >= axis[0] - half_bin) & (found.u <= axis[-1] + half_bin)
    snapshot, line = np.nonzero(shown & (np.abs(found.amplitude) > 0.0))
    order = np.argsort(-np.abs(found.amplitude[snapshot, line]), kind="stable")
    snapshot, line = snapshot[order], line[order]
    rows, peaks = row[snapshot], peak[snapshot]
    u, level = found.u[snapshot, line], amplitude_to_db(found.amplitude[snapshot, line])
    speed = np.asarray(velocity, dtype=np.float64)[peaks, rows]
    cell = speed / radar.waveform.velocity_step_mps
    near = SAME_ANGLE_CELLS * array.resolution_cell
    kept, offset = _targets(rows, cell, u, level, radar.waveform.chirps, near)
    certain = np.full(len(u), np.nan)
    if probability is not None:
        certain = _around(probability, peaks, rows, u, axis)
    return Detections(
        range_m=((rows + offset) * radar.waveform.range_step_m)[kept],
        u=u[kept],
        velocity=speed[kept],
        amplitude_db=level[kept],
        u_std=found.u_std[snapshot, line][kept],
        probability=certain[kept],
    )


def new_peaks(velocity: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[D, R] which Doppler peaks of a range bin, by their velocities [D, R], do not repeat an earlier one."""
    new = [(velocity[:d] != velocity[d]).all(axis=0) for d in range(len(velocity))]
    return np.array(new, dtype=bool).reshape(velocity.shape)


def hann_envelope_db(offset: NDArray[np.floating]) -> NDArray[np.float64]:
    """Level of a Hann window's response [dB] at most, this many bins from its peak: 0 below 1.5, then its envelope.

    The response is sinc(x) / (1 - x^2), that of its sidelobes at most 1 / (pi x (x^2 - 1)).
    """
    distance = np.maximum(np.abs(np.asarray(offset, dtype=np.float64)), LEAST_OFFSET)
    fallen = -20.0 * np.log10(np.pi * distance * (distance**2 - 1.0))
    return np.where(np.abs(offset) < LEAST_OFFSET, 0.0, fallen)


def _targets(
    row: NDArray[np.intp],
    cell: NDArray[np.float64],
    u: NDArray[np.float64],
    level_db: NDArray[np.float64],
    chirps: int,
    near: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """([N] which lines, the strongest first, no stronger one explains, [N] bins from their row to the target).

    A peak between two bins stands up to half a bin from either: the window's response counts from there.
    """
    kept, offset = np.ones(len(u), dtype=bool), np.zeros(len(u))
    by_angle = np.argsort(u, kind="stable")
    first = np.searchsorted(u[by_angle], u - near, side="left")
    last = np.searchsorted(u[by_angle], u + near, side="right")
    for index in range(len(u)):
        beside = by_angle[first[index] : last[index]]
        bins = row[beside] - row[index]
        cells = (cell[beside] - cell[index] + 0.5 * chirps) % chirps - 0.5 * chirps
        stronger = beside < index
        window = hann_envelope_db(np.maximum(np.abs(bins) - 0.5, 0.0))
        window += hann_envelope_db(np.maximum(np.abs(cells) - 0.5, 0.0))
        there = stronger & ((bins != 0) | (np.abs(cells) > 0.5))
        kept[index] = not (there & (level_db[index] < level_db[beside] + window + LOBE_MARGIN_DB)).any()
        same = np.abs(cells) < 0.5
        before, after = (_magnitude(level_db[beside][same & (bins == step)], level_db[index]) for step in (-1, 1))
        if kept[index] and before > 0.0 and after > 0.0:
            # Exact for one target through a Hann window: 1 / (d (1 - d^2)) and 1 / (d (1 +- d) (2 +- d)).
            offset[index] = np.clip(2.0 * (after - before) / (before + 2.0 + after), -0.5, 0.5)
    return kept, offset


def _magnitude(levels_db: NDArray[np.float64], reference_db: float) -> float:
    """The largest of these over a reference, linear; 0 where there is none."""
    return float(10.0 ** ((levels_db.max() - reference_db) / 20.0)) if len(levels_db) else 0.0


def _around(
    probability: NDArray[np.floating],
    peak: NDArray[np.intp],
    row: NDArray[np.intp],
    u: NDArray[np.float64],
    axis: NDArray[np.float64],
) -> NDArray[np.float64]:
    """[N] the larger probability of the two bins around each angle: a head marks the bin, the line falls beside it."""
    below = np.clip(np.searchsorted(axis, u, side="right") - 1, 0, len(axis) - 1)
    above = np.minimum(below + 1, len(axis) - 1)
    return np.maximum(probability[peak, row, below], probability[peak, row, above]).astype(np.float64)
