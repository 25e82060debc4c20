"""How far the power in a resolution cell is from its average over realisations of the rays.

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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.knobs import Effort, KnobSettings
from datafactory.accuracy.samples import Sample
from datafactory.paths.density import cell_power
from datafactory.paths.solver import TraceSettings

Real = NDArray[np.float64]

DRAW, REFERENCE = 1000, 500
"""Draw d has realisations from 1000 d + 1 on, and its reference those from 1000 d + 501 on; 0 is the run's own."""


@dataclass(frozen=True)
class Realisations:
    """Power in the cells, by realisation.

    :param power: [M, R, U'] of :func:`datafactory.paths.density.cell_power` [W]
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
    key = (sample.frame_id, settings.trace, settings.budget_db, first, count)
    if key not in kept:
        power, paths = [], []
        for number in range(first, first + count):
            table = sample.lit_paths(knobs, number)
            power.append(cell_power(table, sample.radar, settings.processing.truth_window))
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
