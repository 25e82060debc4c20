"""How sure the first line of a group must be, for a number of false lines in a frame of noise.

A line is sought in R range bins and N Doppler cells, but only the cells are fitted that were chosen for their power
over all C channels: the strongest of a bin (its other two Doppler peaks have a threshold that noise does not reach), or
what passes a test of constant false-alarm rate. In noise a cell is chosen whose power, in units of that of one channel,
is above tau,

    Q(C, tau) = the share of cells that are chosen

with Q the upper tail of the Gamma distribution of shape C. A line that takes the energy t leaves C - 1 degrees of
freedom, so that its cell is chosen with probability Q(C - 1, tau - t). Beyond a threshold t_0, which noise passes with
probability p (:func:`trainer.estimators.fitting.line_threshold`), t - t_0 is nearly exponential. So a frame of noise
lists

    R N p E[Q(C - 1, tau - t_0 - e)],    e exponential

lines. Left out: neighbouring cells have noise in common, a group of three bins has a range to choose, and of several
groups one lists a line. Measured counts are in docs/notes/points.md.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincc, gammainccinv

from shared.radar import Radar
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import line_threshold

LEAST_PROBABILITY, MOST_PROBABILITY = 1e-12, 0.5
"""Between which the answer is sought; beyond, the nearer one serves."""
QUADRATURE = 40
"""Points of the expectation over e (Gauss and Laguerre)."""


def first_line_probability(lines: float, radar: Radar, array: LineArray, chosen_share: float) -> float:
    """p of the module's equation.

    :param lines: of a frame of noise
    :param array: in which lines are fitted; cells are chosen by all channels of the radar
    :param chosen_share: of a frame's cells; 1 where every cell is fitted
    """
    searched = radar.waveform.range_bins * radar.waveform.chirps

    def excess(log_probability: float) -> float:
        probability = float(np.exp(log_probability))
        chosen = chosen_probability(line_threshold(array, probability), radar.array.channels, chosen_share)
        return log_probability + float(np.log(searched * chosen) - np.log(lines))

    low, high = np.log(LEAST_PROBABILITY), np.log(MOST_PROBABILITY)
    if excess(high) <= 0.0:
        return MOST_PROBABILITY
    return float(np.exp(brentq(excess, low, high))) if excess(low) < 0.0 else LEAST_PROBABILITY


def chosen_probability(threshold: float, channels: int, share: float) -> float:
    """That a cell is chosen whose line takes more than ``threshold`` times the noise of one channel."""
    if share >= 1.0:
        return 1.0
    beyond, weights = np.polynomial.laguerre.laggauss(QUADRATURE)
    rest = np.maximum(gammainccinv(channels, share) - threshold - beyond, 0.0)
    return float(weights @ np.where(rest > 0.0, gammaincc(max(channels - 1, 1e-9), rest), 1.0))
