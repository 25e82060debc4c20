"""How certain a listed line is: what it must pass, for a number of false lines in a frame of noise, and the probability
that it is an echo.

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

**Probability.** A line that passed the test for noise may still be none: the flank of a neighbour, a ghost of a board's
errors, an echo of unlike ways out and back, which no one angle explains. How often that is so falls with the line's
level L over the noise that the fit is told [dB], all channels added, and where a network has a detection head with the
logit of what that says at the line:

    P = 1 / (1 + exp(-(a + b L + c logit h)))

(Platt, "Probabilistic outputs for support vector machines", 1999: the head's own h is the share of pixels that hold a
peak of the truth, which few do). a, b and c are rounded means of what fits the lines of simulated drives best, of which
the paths are known; ``python tests/benchmarks/driven_points.py`` prints them: docs/notes/points.md. Limit: lines of a
board's phase noise are told from echoes by neither level nor head.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import expit, gammaincc, gammainccinv, logit

from shared.radar import Radar
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import line_threshold

LEAST_PROBABILITY, MOST_PROBABILITY = 1e-12, 0.5
"""Between which the answer is sought; beyond, the nearer one serves."""
QUADRATURE = 40
"""Points of the expectation over e (Gauss and Laguerre)."""

BY_LEVEL = (-1.2, 0.137, 0.0)
"""(a, b, c) of a method without a detection head."""
BY_HEAD = (2.3, 0.057, 0.55)
"""(a, b, c) with one."""
HIGHEST_DB = 45.0
"""Beyond, a line is as often a ghost of a strong echo as an echo: what is stronger is no more likely."""
LEAST = 1e-4
"""Of h and of 1 - h: their logit stays finite, and heads of less do not differ."""


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


def line_probability(snr_db: NDArray[np.float64], head: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """P [N] of lines of L = ``snr_db`` [N], h = ``head`` [N]; None without a detection head."""
    a, b, c = BY_LEVEL if head is None else BY_HEAD
    said = 0.0 if head is None else logit(np.clip(head, LEAST, 1.0 - LEAST))
    return np.asarray(expit(a + b * np.minimum(snr_db, HIGHEST_DB) + c * said))
