"""How certain a listed line is: the probability that it is an echo.

A line that passed the test for noise may still be none: the flank of a neighbour, a ghost of a board's
errors, an echo of unlike ways out and back, which no one angle explains. How often that is so falls with the line's
level L over the noise that the fit is told [dB], all channels added, and where a network has a detection head with the
logit of what that says at the line:

    P = 1 / (1 + exp(-(a + b L + c logit h)))

(Platt, "Probabilistic outputs for support vector machines", 1999: the head's own h is the share of pixels that hold a
peak of the truth, which few do). a, b and c are near what fits the lines of simulated drives through two cities best,
of which the paths are known; ``python tests/benchmarks/driven_points.py`` prints those of one drive:
docs/notes/points.md. Limit: lines of a board's phase noise are told from echoes by neither level nor head.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

BY_LEVEL = (-1.15, 0.116, 0.0)
"""(a, b, c) of a method without a detection head."""
BY_HEAD = (1.7, 0.062, 0.49)
"""(a, b, c) with one."""
HIGHEST_DB = 45.0
"""Beyond, a line is as often a ghost of a strong echo as an echo: what is stronger is no more likely."""
LEAST = 1e-4
"""Of h and of 1 - h: their logit stays finite, and heads of less do not differ."""


def line_probability(snr_db: NDArray[np.float64], head: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """P [N] of lines of L = ``snr_db`` [N], h = ``head`` [N]; None without a detection head."""
    a, b, c = BY_LEVEL if head is None else BY_HEAD
    said = 0.0 if head is None else logit(np.clip(head, LEAST, 1.0 - LEAST))
    return np.asarray(expit(a + b * np.minimum(snr_db, HIGHEST_DB) + c * said))
