"""Orthogonal matching pursuit, stopped by the known noise power or at a constant false-alarm rate."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaincinv, gammaln

from trainer.estimators.array import LineArray, NoisePower, draw_lines, image_rows, scan_axis, uniform_axis
from trainer.estimators.fitting import line_threshold
from trainer.estimators.lines import (
    best_refit,
    bounded_amplitudes,
    bounded_energy_left,
    line_amplitudes,
    pairs_elsewhere,
    refine_lines,
)

MOST_LINES = 16
"""In a range bin, and at most half the channels: beyond that no sparse solution is known to be the only one."""
FALSE_ALARM = 0.01
"""Probability that a range bin of noise alone gets a line."""
SEARCH_POINTS = 8
"""Angles in a resolution cell from which lines leave the grid."""
ROUNDING = 1e-20
"""Energy left, of the snapshot's: less is rounding."""
PAIRS = 3
"""Pairs of angles that are refined in the place of the two newest lines."""


class OrthogonalMatchingPursuit:
    """Lines one by one: the largest of |a(u)^H r|, then least squares for all, r = x - A A^+ x.

    Pati, Rezaiifar and Krishnaprasad 1993. Greedy: of two targets within a resolution cell the first line falls
    between them.

    - "noise": angles of the image's axis; goes on while |r|^2 exceeds what noise of the known power leaves in all but
      1 % of the cases, sigma^2 / 2 times the quantile of chi^2 with 2 (C - k) degrees of freedom.
    - "cfar": continuous angles, all refined together after each new line (Newtonised OMP, Mamandipoor, Ramasamy and
      Madhow, IEEE Trans. Signal Process. 64(19), 2016); goes on while the new line takes a larger share of |r|^2 than
      the best line would of noise, whatever its power, with probability :data:`FALSE_ALARM`. Lines that were refined
      to all but one angle explain an error of calibration by amplitudes that cancel: those are bounded, and a line that
      explains nothing more within the bound is the last, see :func:`trainer.estimators.lines.bounded_amplitudes`.

    Two echoes of one level defeat "cfar": the second is the noise in which the first is to stand out, and where their
    sidelobes add the first line is neither (docs/notes/measured.md counts them). The noise of measured rows is known,
    with all that the model leaves out, and told for each row. There a line stays where it takes more than
    :func:`trainer.estimators.fitting.line_threshold` of that noise, and the two newest lines are searched anew as a
    pair beside the others.
    """

    def __init__(self, stop: Literal["noise", "cfar"] = "noise") -> None:
        self.stop = stop

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] lines with their magnitudes [sqrt(W)], each in its nearest bin of u [U].

        :param noise_power: [W]; 0 lets "noise" go on to rounding or the largest number of lines; one number for all
            rows is not used by "cfar"
        """
        known = self.stop == "cfar" and np.ndim(noise_power) == 1
        axis = scan_axis(array, u)[0] if self.stop == "noise" else uniform_axis(array, SEARCH_POINTS)
        most = min(MOST_LINES, max(array.channels // 2, 1))
        if self.stop == "noise":
            limits = [float(gammaincinv(array.channels - k, 0.99)) for k in range(most)]
        elif known:
            limits = [line_threshold(array, FALSE_ALARM)] * most
        else:
            limits = [largest_share_of_noise(array, array.channels - k) for k in range(most)]

        conjugate = array.manifold(axis).conj()
        least_squares = bounded_amplitudes if self.stop == "cfar" else line_amplitudes

        def solve(x: NDArray[np.complex128], noise: NDArray[np.float64]) -> NDArray[np.float64]:
            """A row leaves the loop when its stopping rule says so; amplitudes are 0 where there is no line."""
            found = np.zeros((len(x), len(limits)))
            amplitude = np.zeros(found.shape, dtype=np.complex128)
            going, left = np.arange(len(x)), x
            total = np.sum(np.abs(x) ** 2, axis=1)
            for k, limit in enumerate(limits):
                best = axis[np.argmax(np.abs(left @ conjugate), axis=1)]
                lines = np.concatenate([found[going, :k], best[:, None]], axis=1)
                if self.stop == "cfar":
                    lines = refine_lines(x[going], lines, array)
                if known and k:
                    lines = _pair_anew(x[going], lines, array, axis)
                amplitudes, after = least_squares(x[going], lines, array)
                energy, remains = np.sum(np.abs(left) ** 2, axis=1), np.sum(np.abs(after) ** 2, axis=1)
                goes_on = energy > ROUNDING * total[going]
                if self.stop == "noise":
                    goes_on &= energy > noise[going] * limit
                elif known:
                    goes_on &= energy - remains > noise[going] * limit
                else:
                    goes_on &= energy - remains > limit * energy
                going, left = going[goes_on], after[goes_on]
                found[going, : k + 1], amplitude[going, : k + 1] = lines[goes_on], amplitudes[goes_on]
                if not len(going):
                    break
            return draw_lines(found, np.abs(amplitude), array, u)

        return image_rows(snapshots, array, len(u), noise_power, solve)


def _pair_anew(
    x: NDArray[np.complex128], lines: NDArray[np.float64], array: LineArray, axis: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[B, K] lines [B, K], K from 2, with the best pair beside the others in the place of the last two, where that
    leaves less."""
    trials = pairs_elsewhere(x, array, axis, lines[:, :-2], lines[:, -2:], PAIRS)
    best, left = best_refit(x, trials, array, measure=bounded_energy_left)
    better = left < bounded_energy_left(x, lines, array)
    return np.where(better[:, None], best, lines)


def largest_share_of_noise(array: LineArray, dimensions: int) -> float:
    """Share of the energy of white noise that its best line takes with probability :data:`FALSE_ALARM`.

    For noise uniform on the sphere of C complex dimensions the share at one angle is above t with probability
    (1 - t)^(C - 1). Over a curve of manifold vectors the expected number of upcrossings (Rice 1944; the tube of
    Hotelling 1939 and Weyl 1939) is

        N(t) = Delta u beta / sqrt(pi) sqrt(t) (1 - t)^(C - 3/2) Gamma(C) / Gamma(C - 1/2),   beta = k std(p),

    with Delta u the period of u, and the sum of both bounds the probability that any angle is above t. With lines
    already found C is what they leave of the channels: an approximation.

    :param dimensions: C; with fewer than 2 every angle takes all, and the share is 1: nothing is ever found
    """
    if dimensions < 2:
        return 1.0
    beta = 2.0 * np.pi / array.wavelength_m * float(np.std(array.positions_m))
    curve = 2.0 * array.half_period * beta / np.sqrt(np.pi) * np.exp(gammaln(dimensions) - gammaln(dimensions - 0.5))

    def excess(share: float) -> float:
        point = (1.0 - share) ** (dimensions - 1)
        return point + curve * np.sqrt(share) * (1.0 - share) ** (dimensions - 1.5) - FALSE_ALARM

    # N rises and then falls: the level sought is on the falling side.
    return float(brentq(excess, 1.0 / (2.0 * dimensions - 2.0), 1.0))
