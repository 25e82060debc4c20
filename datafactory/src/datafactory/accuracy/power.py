"""How far the power in a resolution cell is from its average over realisations of the rays.

A frame has one realisation. The power in a cell, summed over its paths without phase, is free of speckle; its average
over realisations does not depend on the number of rays, and one realisation scatters around it the less the more
rays there are. With P_i the cells' power in realisation i and Q its average in a much denser reference:

* amplitude over peak: mean over i of max over cells |sqrt(P_i) - sqrt(Q)|, over max sqrt(Q): what an image's error
  over its peak would be;
* relative L2 of the amplitudes: rms over i of |sqrt(P_i) - sqrt(Q)|_2 over |sqrt(Q)|_2;
* L1 of the power: mean over i of sum |P_i - Q| / sum Q, once as received, once with both weighted by range^4;
* bias of the total power: mean over i of sum P_i / sum Q.

Q is itself a mean over few realisations. The squared differences contain its variance, which is estimated from their
scatter and subtracted: var(sqrt Q) = var(Q) / 4 Q by first-order propagation. Realisations of P and Q are disjoint.
Where a setting changes something else than the sampling (depth, effects), both have the same rays, P_i is held against
Q_i, and there is nothing to subtract.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.knobs import DEFAULT, KnobSettings
from datafactory.accuracy.samples import SampleFrame, lit_paths
from datafactory.frame.defaults import IMAGE_BATCH
from datafactory.paths.density import cell_power
from shared.radar import Radar

Real = NDArray[np.float64]

DRAW, REFERENCE = 1000, 500
"""Draw d has realisations from 1000 d + 1 on, and its reference those from 1000 d + 501 on; 0 is the run's own."""


MOST_REALISATIONS = 16
"""Where single rays rule a frame (50 000 of them, few surfaces, error -10 dB), two draws of 4 differed by 3.5 dB, and
two of 16 by 1 dB.
"""


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    :param reference_rays: rays of the converged tracing
    :param realisations: of the rays, of every setting; of few rays there are more, see :meth:`count`
    :param reference_realisations: of the reference
    :param repeats: of each timed stage and frame
    :param batch: frames that share the image stage
    :param rays: of every setting that does not state its own
    """

    reference_rays: int
    realisations: int = 4
    reference_realisations: int = 4
    repeats: int = 1
    batch: int = IMAGE_BATCH
    rays: int = DEFAULT.rays

    @property
    def in_turn(self) -> int:
        """Repeats of two frames whose times are compared: two or more."""
        return max(self.repeats, 2)

    def count(self, rays: int) -> int:
        """Realisations of this many rays: few rays scatter most, and more of them cost little."""
        return min(max(self.realisations, self.realisations * self.reference_rays // (4 * rays)), MOST_REALISATIONS)


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
    """See the module; ``peak`` and ``l2`` are amplitude ratios, the others power ratios."""

    peak: float
    l2: float
    l1: float
    l1_range_weighted: float
    total: float


Kept = dict[tuple[int, KnobSettings, int, int], Realisations]
"""Realisations by frame, settings, first number and count."""


def realisations(
    sample: SampleFrame, settings: KnobSettings, radar: Radar, first: int, count: int, kept: Kept
) -> Realisations:
    """Realisations ``first`` to ``first + count - 1``, traced unless ``kept`` holds them; added to it."""
    key = (sample.frame_id, settings.tracing(), first, count)
    if key not in kept:
        power, paths = [], []
        for number in range(first, first + count):
            table = lit_paths(sample, settings, radar, number)
            power.append(cell_power(table, radar, settings.truth_window))
            paths.append(len(table))
        kept[key] = Realisations(np.array(power), float(np.mean(paths)))
    return kept[key]


def power_error(
    sample: SampleFrame,
    settings: KnobSettings,
    against: KnobSettings,
    effort: Effort,
    radar: Radar,
    kept: Kept,
    paired: bool = False,
    draw: int = 0,
) -> PowerError:
    """The errors of ``settings`` held against ``against``.

    :param paired: both with the same rays; otherwise ``against`` has a reference's own
    :param draw: number of an independent draw of all these rays
    """
    first = DRAW * draw + 1
    if paired:
        value, expected = (
            realisations(sample, wanted, radar, first, effort.realisations, kept).power
            for wanted in (settings, against)
        )
        return compared(value, expected, np.zeros(1), radar)
    value = realisations(sample, settings, radar, first, effort.count(settings.rays), kept).power
    numbers = (first + REFERENCE, effort.reference_realisations)
    expected, variance = mean_and_variance(realisations(sample, against, radar, *numbers, kept).power)
    return compared(value, expected, variance, radar)


def mean_and_variance(power: Real) -> tuple[Real, Real]:
    """Of the mean Q of M realisations [M, R, U']: Q [R, U'], and the variance of sqrt(Q) [R, U'] that its scatter
    tells of; none of a single realisation.
    """
    mean = power.mean(axis=0)
    if len(power) < 2:
        return mean, np.zeros_like(mean)
    of_mean = power.var(axis=0, ddof=1) / len(power)
    return mean, np.divide(of_mean, 4.0 * mean, out=np.zeros_like(mean), where=mean > 0.0)


def compared(value: Real, expected: Real, variance: Real, radar: Radar) -> PowerError:
    """Realisations [M, R, U'] held against one expectation [R, U'] or each against its own [M, R, U'].

    :param variance: of sqrt(expected), to subtract; broadcast to the cells
    """
    expected = np.broadcast_to(expected, value.shape)
    peak, total = np.sqrt(expected.max()), expected.sum(axis=(1, 2))
    if not peak > 0.0:
        wrong = float(value.any())
        return PowerError(wrong, wrong, wrong, wrong, 1.0)
    squared = np.maximum((np.sqrt(value) - np.sqrt(expected)) ** 2 - variance, 0.0)
    unbiased = np.maximum(np.sum((np.sqrt(value) - np.sqrt(expected)) ** 2 - variance, axis=(1, 2)), 0.0)
    difference, weight = np.abs(value - expected).sum(axis=2), radar.waveform.ranges_m**4
    weighted = expected.sum(axis=2) @ weight
    return PowerError(
        peak=float(np.mean(np.sqrt(squared.max(axis=(1, 2)))) / peak),
        l2=float(np.sqrt(np.mean(unbiased / np.maximum(total, np.finfo(float).tiny)))),
        l1=_mean_share(difference.sum(axis=1), total),
        l1_range_weighted=_mean_share(difference @ weight, weighted),
        total=_mean_share(value.sum(axis=(1, 2)), total),
    )


def _mean_share(part: Real, whole: Real) -> float:
    return float(np.mean(part / np.where(whole > 0.0, whole, 1.0)))
