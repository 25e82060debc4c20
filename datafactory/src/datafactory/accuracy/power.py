"""How far the power in a resolution cell is from its average over realisations of the rays. Errors are
amplitude ratios in every table here, and their levels in dB are finite, with a floor.

A frame has one realisation. The power in a cell, summed over its paths without phase, is free of speckle; its average
over realisations does not depend on the number of rays, and one realisation scatters around it the less the more
rays there are. With P_i the cells' power in realisation i and Q its average in a much denser reference:

* amplitude over peak: mean over i of max over cells |sqrt(P_i) - sqrt(Q)|, over max sqrt(Q): what an image's error
  over its peak would be;
* bias of the total power: mean over i of sum P_i / sum Q.

Q is itself a mean over few realisations. The squared differences contain its variance, which is estimated from their
scatter and subtracted: var(sqrt Q) = var(Q) / 4 Q by first-order propagation. Realisations of P and Q are disjoint.
Where a setting changes something else than the sampling (depth), both have the same rays, P_i is held against Q_i, and
there is nothing to subtract.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from datafactory.accuracy.knobs import Effort, KnobSettings, Sample
from datafactory.paths.cells import cell_power
from datafactory.paths.solver import TraceSettings
from shared.physics.units import amplitude_to_db
from shared.physics.vectors import Real

FLOOR_DB = -200.0
WORDS = {"cube_db": "cube", "image_db": "image", "power_db": "power in a cell"}
DRAW, REFERENCE = 1000, 500
"""Draw d has realisations from 1000 d + 1 on, and its reference those from 1000 d + 501 on; 0 is the run's own."""


def level_db(ratio: float) -> float:
    """An amplitude ratio in dB, not below FLOOR_DB."""
    return float(amplitude_to_db(ratio, FLOOR_DB))


def worst_db(ratios: Sequence[float]) -> float | None:
    """The largest of amplitude ratios in dB; None where nothing was measured."""
    return level_db(max(ratios)) if ratios else None


def relative_l2(value: NDArray, reference: NDArray) -> float:
    """|value - reference| / |reference| over all elements; 0 where both are empty of signal, 1 where only one is."""
    scale = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(value - reference))
    return difference / scale if scale > 0.0 else float(difference > 0.0)


def peak_error(value: NDArray, reference: NDArray) -> float:
    """Largest difference over the reference's peak magnitude."""
    peak = float(np.abs(reference).max(initial=0.0))
    difference = float(np.abs(value - reference).max(initial=0.0))
    return difference / peak if peak > 0.0 else float(difference > 0.0)


class Errors(BaseModel, frozen=True, extra="forbid"):
    """The three errors [dB], the largest over the frames, to 0.1 dB so that the last bits of a sum do not decide.

    None of cube and image where only paths are made.
    """

    cube_db: float | None
    image_db: float | None
    power_db: float

    @staticmethod
    def of(cube: Sequence[float], image: Sequence[float], power: Sequence[float]) -> Errors:
        """The largest of amplitude ratios; none of a cube or image that is not made."""
        levels = [None if level is None else round(level, 1) for level in map(worst_db, (cube, image, power))]
        return Errors.model_validate(dict(zip(WORDS, levels, strict=True)))

    def measured(self) -> dict[str, float]:
        """Name and level of those that there are."""
        return {name: value for name, value in self.model_dump().items() if value is not None}

    def excess_db(self, budget_db: float) -> tuple[float, ...]:
        """By how much each exceeds a budget, 0 where it does not, the largest first."""
        return tuple(sorted((max(value - budget_db, 0.0) for value in self.measured().values()), reverse=True))

    @property
    def worst_db(self) -> float:
        return max(self.measured().values())

    def __str__(self) -> str:
        return ", ".join(f"{WORDS[name]} {value:.1f}" for name, value in self.measured().items()) + " dB"


def worst_of(frames: Sequence[Errors]) -> Errors:
    """The largest of each error; all have the same ones."""
    every = [errors.measured() for errors in frames]
    largest = {name: max(errors[name] for errors in every) for name in every[0]}
    return Errors.model_validate(dict.fromkeys(WORDS) | largest)


@dataclass(frozen=True)
class Realisations:
    """Power in the cells, by realisation.

    :param power: [M, R, U'] of :func:`datafactory.paths.cells.cell_power` [W]
    :param paths: mean number
    """

    power: Real
    paths: float


@dataclass(frozen=True)
class PowerError:
    """See the module; ``peak`` is an amplitude ratio, ``total`` one of power.

    :param paths: mean number of a realisation
    """

    peak: float
    total: float
    paths: float = 0.0


Kept = dict[tuple[int, TraceSettings, float | None, int, int], Realisations]
"""Realisations of a run's frames by frame, by what of a run's settings differs, by first number and count."""


def realisations(sample: Sample, knobs: KnobSettings, first: int, count: int, kept: Kept) -> Realisations:
    """Realisations ``first`` to ``first + count - 1``, traced unless ``kept`` holds them; added to it."""
    settings = sample.settings(knobs)
    key = (sample.frame.frame_id, settings.trace, settings.budget_db, first, count)
    if key not in kept:
        power, paths = [], []
        for number in range(first, first + count):
            table = sample.lit_paths(knobs, number)
            power.append(cell_power(table, sample.order.radar, settings.processing.truth_window))
            paths.append(len(table))
        kept[key] = Realisations(np.array(power), float(np.mean(paths)))
    return kept[key]


def paired_error(sample: Sample, knobs: KnobSettings, against: KnobSettings, effort: Effort, kept: Kept) -> PowerError:
    """The errors of settings held against others with the same rays."""
    value, expected = (realisations(sample, each, 1, effort.realisations, kept) for each in (knobs, against))
    return compared(value, expected.power, np.zeros(1))


def power_error(
    sample: Sample,
    knobs: KnobSettings,
    reference: Sample,
    against: KnobSettings,
    effort: Effort,
    kept: Kept,
    draw: int = 0,
) -> PowerError:
    """The errors of settings held against those of a reference with rays of its own.

    :param reference: the same frame, or complete
    :param draw: number of an independent draw of all these rays
    """
    first = DRAW * draw + 1
    value = realisations(sample, knobs, first, effort.count(knobs.rays), kept)
    expected = realisations(reference, against, first + REFERENCE, effort.reference_realisations, kept)
    return compared(value, *mean_and_variance(expected.power))


def mean_and_variance(power: Real) -> tuple[Real, Real]:
    """Of the mean Q of M realisations [M, R, U']: Q [R, U'], and the variance of sqrt(Q) [R, U'] that its scatter
    tells of; none of a single realisation.
    """
    mean = power.mean(axis=0)
    if len(power) < 2:
        return mean, np.zeros_like(mean)
    of_mean = power.var(axis=0, ddof=1) / len(power)
    return mean, np.divide(of_mean, 4.0 * mean, out=np.zeros_like(mean), where=mean > 0.0)


def compared(value: Realisations, expected: Real, variance: Real) -> PowerError:
    """Realisations held against one expectation [R, U'] or each against its own [M, R, U'].

    :param variance: of sqrt(expected), to subtract; broadcast to the cells
    """
    power = value.power
    expected = np.broadcast_to(expected, power.shape)
    peak, total = np.sqrt(expected.max()), expected.sum(axis=(1, 2))
    if not peak > 0.0:
        return PowerError(float(power.any()), 1.0, value.paths)
    squared = np.maximum((np.sqrt(power) - np.sqrt(expected)) ** 2 - variance, 0.0)
    return PowerError(
        peak=float(np.mean(np.sqrt(squared.max(axis=(1, 2)))) / peak),
        total=float(np.mean(power.sum(axis=(1, 2)) / np.where(total > 0.0, total, 1.0))),
        paths=value.paths,
    )
