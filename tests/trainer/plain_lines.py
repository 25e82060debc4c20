"""One row's lines by the procedure of :mod:`trainer.estimators.groups`, plainly: the slow reference of its tests."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trainer.estimators import groups
from trainer.estimators.array import LineArray, uniform_axis
from trainer.estimators.fitting import MOST_LINES, RESIDUAL_TAIL, SEARCH_POINTS
from trainer.estimators.group_replacements import CROWDED, ELSEWHERE, MOST_SEARCHED
from trainer.estimators.group_steps import PRUNING_STEPS
from trainer.estimators.lines import additions, bounded_energy_left, pairs_elsewhere, refit

Lines = NDArray[np.float64]
"""[K] angles."""


def without(u: Lines) -> list[Lines]:
    """The lines without each of them."""
    return [np.delete(u, line) for line in range(len(u))]


def splits(u: Lines, distances: Sequence[float]) -> list[Lines]:
    """Each of the lines in two, at each of these distances in u."""
    return [
        np.concatenate([np.delete(u, line), u[line] + 0.5 * apart * np.array([-1.0, 1.0])])
        for line in range(len(u))
        for apart in distances
    ]


class PlainFit:
    """Lines of one row x [C] in noise of this power, each worth ``threshold`` times the noise."""

    def __init__(self, x: NDArray[np.complex128], array: LineArray, noise: float, threshold: float) -> None:
        self.x, self.array, self.noise, self.price = x[None], array, noise, threshold * noise
        self.most = max(min(MOST_LINES, array.channels // 2), 1)
        self.axis = uniform_axis(array, SEARCH_POINTS)
        self.u: Lines = np.empty(0)

    def lines(self, given: Sequence[float] = ()) -> Lines:
        """Their angles, rising."""
        lone = self._added(self.u)[0]
        if self._refined(self.u, 0)[1] - self._refined(lone, int(PRUNING_STEPS))[1] > self.price:
            self.u = np.array(given)[: self.most] if len(given) else lone
            self._begin()
            self._prune()
            self._take(self.u if len(self.u) else lone, int(groups.STEPS))
            self._improve()
            self._begin_elsewhere()
            self._take(self.u, int(groups.STEPS))
        return np.sort(self.u)

    def _improve(self) -> None:
        for _ in range(groups.ROUNDS):
            grown = self._grow()
            before = self.u
            if grown:
                self._prune()
            if 0 < len(self.u) <= 2:
                self._replace(self._added(np.empty(0), ELSEWHERE))
            if len(self.u) >= 2:
                self._pairs()
            if len(self.u) > 2 and CROWDED * len(self.u) >= self.array.channels:
                self._merge()
            if self.u is before:
                break

    def _begin_elsewhere(self) -> None:
        for start in self._added(np.empty(0), groups.STARTS):
            if not self._fails(0.0 if 2 * len(self.u) > self.most else self.price):
                break
            ended = self.u
            self._take(start, int(PRUNING_STEPS))
            while len(self.u) < self.most:
                self._take(self._added(self.u)[0], int(PRUNING_STEPS))
            self._prune()
            self._improve()
            self.u = min(ended, self.u, key=lambda u: self.left(u) + len(u) * self.price)

    def left(self, u: Lines) -> float:
        return float(bounded_energy_left(self.x, u[None], self.array)[0])

    def _fails(self, spare: float = 0.0) -> bool:
        """Whether more is left than noise leaves and ``spare``."""
        freedom = 2 * self.array.channels - 3 * len(self.u)
        allowed = 0.5 * chi2.ppf(1.0 - RESIDUAL_TAIL, freedom) * self.noise + spare
        return freedom > 0 and self.left(self.u) > allowed

    def _refined(self, u: Lines, steps: int) -> tuple[Lines, float]:
        if not len(u):
            return u, float(np.sum(np.abs(self.x) ** 2))
        lines, left = refit(self.x, u[None], self.array, steps, bounded_energy_left)
        return lines[0], float(left[0])

    def _take(self, u: Lines, steps: int) -> None:
        self.u = self._refined(u, steps)[0]

    def _added(self, u: Lines, count: int = 1) -> NDArray[np.float64]:
        return additions(self.x, self.array, self.axis, u[None], count)[0]

    def _begin(self) -> None:
        while len(self.u) > 1:
            costs = [self.left(fewer) - self.left(self.u) for fewer in without(self.u)]
            if min(costs) >= self.price:
                break
            self.u = np.delete(self.u, int(np.argmin(costs)))
        self._take(self.u, int(PRUNING_STEPS))

    def _prune(self) -> None:
        while len(self.u):
            trials = [self._refined(fewer, int(PRUNING_STEPS)) for fewer in without(self.u)]
            best, left = min(trials, key=lambda trial: trial[1])
            if left - self.left(self.u) >= self.price:
                break
            self.u = best

    def _grow(self) -> bool:
        grown = False
        distances = [cells * self.array.resolution_cell for cells in groups.SPLIT_CELLS]
        while 0 < len(self.u) < self.most:
            if not self._fails():
                break
            left = self.left(self.u)
            begun = [*self._added(self.u), *splits(self.u, distances)]
            raced = sorted(
                (self._refined(trial, int(groups.RACE_STEPS)) for trial in begun), key=lambda trial: trial[1]
            )
            ended = [self._refined(trial, int(groups.STEPS)) for trial, _ in raced[: groups.RACE_KEPT]]
            best, least = min(ended, key=lambda trial: trial[1])
            if left - least <= self.price:
                break
            self.u, grown = best, True
        return grown

    def _pairs(self) -> None:
        count, none = len(self.u), np.empty(0)
        self._replace(self._beside(none, self.u if count == 2 else none))
        for line in range(count if 2 < count <= MOST_SEARCHED else 0):
            if len(self.u) == count:
                self._replace(self._beside(self.u[line : line + 1], none))

    def _merge(self) -> None:
        self._replace(np.stack([self._added(fewer)[0] for one in without(self.u) for fewer in without(one)]))

    def _beside(self, kept: Lines, avoided: Lines) -> NDArray[np.float64]:
        return pairs_elsewhere(self.x, self.array, self.axis, kept[None], avoided[None], ELSEWHERE)[0]

    def _replace(self, trials: NDArray[np.float64]) -> None:
        best, left = min((self._refined(trial, int(PRUNING_STEPS)) for trial in trials), key=lambda trial: trial[1])
        if left < self.left(self.u) + (len(self.u) - len(best)) * self.price:
            self.u = best
