"""Maximum likelihood for a known number of targets: the ceiling for any estimator that is not told more."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.estimators.array import (
    LineArray,
    NoisePower,
    check_snapshots,
    draw_lines,
    row_powers,
    scaled_blocks,
    uniform_axis,
)
from trainer.estimators.lines import (
    STEPS,
    additions,
    beside_lines,
    best_refit,
    bounded_amplitudes,
    line_amplitudes,
    pair_energy,
    pairs_elsewhere,
    raced,
    refine_lines,
    refit,
)

SEARCH_POINTS, CANDIDATES = 6, 8
"""Angles searched in a resolution cell, and pairs refined: of 6 400 random pairs (10 and 30 dB, 0.25 to 3.3 cells, 18
and 12 channels) none ended worse than a refinement from the truth; with 4 and 6 it was 0.2 %, with one candidate
4 %."""
LOBES = 3
"""Of a lone line, that are refined: off the grid another one may explain more than the highest on it."""
PAIR_POINTS, FIRSTS, SECONDS, ADDED = 4, 32, 8, 3
"""Three and more lines: angles searched in a resolution cell; first angles tried, second ones beside each for four
lines and more, and further ones beside the best four. The last two of three and four lines are searched as a pair."""
PAIRS_EACH, BEGIN, PAIRS, RACE = 2, ((2, 60), (3, 8)), 8, ((2, 4), (3, 2), (STEPS, 1))
"""Pairs tried beside each such beginning, and beside the others of a result; how they are raced, see
:func:`trainer.estimators.lines.raced`. Of 400 random triples and 400 quadruples, with neighbours 0.25 to 3 cells apart
at 10 to 30 dB, 18 and 12 channels, at most one in a hundred ends worse than a refinement from the truth."""
SEARCHES_AT_ONCE = 512
"""Pair searches of a block of rows: 48 x 48 pairs each in single precision, 10 MB an array."""
CYCLES, GAIN = 4, 1e-6
"""Most rounds over all pairs of lines, and the relative gain of a row that is gone over once more."""


class MaximumLikelihood:
    """The K angles whose manifold vectors leave least of the snapshot: min ||x - A s||^2 over u and s, s = A^+ x.

    Deterministic maximum likelihood in white Gaussian noise (Stoica and Nehorai 1989); efficient above its threshold
    SNR. All pairs of a grid are tried, for three and more lines beside many first ones, and Gauss-Newton steps leave
    the grid. Then any two lines are searched anew beside the others, as single ones are in alternating projection
    (Ziskind and Wax 1988). For K = 1 and 2 the search is exhaustive; for 3 and 4 less than one row in a hundred stops
    at a local optimum. It is told K: an image that beats it clearly knows something else as well.

    Told of more targets than there are, of noise alone for instance, the best angles may be two that all but coincide,
    with amplitudes a thousand times the noise that cancel. The angles stay those of the likelihood; the amplitudes are
    bounded, see :func:`trainer.estimators.lines.bounded_amplitudes`: lines too close to be told apart share their sum.

    :param targets: K, in every range bin, 1 or more
    """

    def __init__(self, targets: int = 2) -> None:
        self.targets = targets

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NoisePower
    ) -> NDArray[np.float64]:
        """[R, U] K lines a row with their magnitudes [sqrt(W)], each in its nearest bin of u [U]."""
        row_powers(noise_power, len(snapshots))
        found, amplitude = self.locate(snapshots, array)
        return draw_lines(found, np.abs(amplitude), array, u)

    def locate(
        self, snapshots: NDArray[np.complexfloating], array: LineArray
    ) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """(u [R, K] rising, complex amplitudes [R, K] [sqrt(W)]); zeros where the snapshot is zero.

        :raises InputError: K so many that they explain any snapshot
        """
        if self.targets >= max(array.channels, 2):
            problem = f"targets = {self.targets} with {array.channels} channels"
            raise InputError("ml", problem, "fewer than channels")
        check_snapshots(snapshots, array)
        found = np.zeros((len(snapshots), self.targets))
        amplitude = np.zeros(found.shape, dtype=np.complex128)
        for block, x, scale in scaled_blocks(snapshots):
            found[block] = np.sort(_search(x, array, self.targets), axis=1)
            amplitude[block] = scale * bounded_amplitudes(x, found[block], array)[0]
        return found, amplitude


def _search(x: NDArray[np.complex128], array: LineArray, targets: int) -> NDArray[np.float64]:
    """[B, K] angles, within one period of u."""
    axis = uniform_axis(array, SEARCH_POINTS)
    if targets == 1:
        lobes = additions(x, array, axis, np.empty((len(x), 0)), LOBES)
        best = best_refit(x, lobes, array)[0]
    elif targets == 2:
        best = _best_pair(x, array, axis)
    else:
        block = SEARCHES_AT_ONCE // FIRSTS if targets == 3 else max(SEARCHES_AT_ONCE // (FIRSTS * SECONDS), 1)
        blocks = [_search_many(x[start : start + block], array, targets) for start in range(0, len(x), block)]
        best = np.concatenate([np.empty((0, targets)), *blocks])
    best = refine_lines(x, best, array)
    half = array.half_period
    return (best + half) % (2.0 * half) - half if half < 1.0 else np.clip(best, -1.0, 1.0)


def _search_many(x: NDArray[np.complex128], array: LineArray, targets: int) -> NDArray[np.float64]:
    """[B, K] angles of three or more lines."""
    axis = uniform_axis(array, PAIR_POINTS)
    rows = len(x)
    score = beside_lines(x, array, axis, np.empty((rows, 0)))[0]
    first = axis[np.argsort(-score, axis=1, kind="stable")[:, :FIRSTS]]
    seeds = first[..., None]
    if targets > 3:
        repeated = np.repeat(x, seeds.shape[1], axis=0)
        seeds = additions(repeated, array, axis, seeds.reshape(-1, 1), SECONDS).reshape(rows, -1, 2)
    repeated = np.repeat(x, seeds.shape[1], axis=0)
    begun = pairs_elsewhere(
        repeated, array, axis, seeds.reshape(len(repeated), -1), np.empty((len(repeated), 0)), PAIRS_EACH
    )
    trials, left = raced(x, begun.reshape(rows, seeds.shape[1] * PAIRS_EACH, -1), array, BEGIN)
    for count in range(4, targets):
        width = trials.shape[1]
        grown = additions(np.repeat(x, width, axis=0), array, axis, trials.reshape(-1, count), ADDED)
        trials, left = raced(x, grown.reshape(rows, -1, count + 1), array, RACE[:1])
    best, least = trials[:, 0], left[:, 0]
    _improve(x, array, axis, best, least)
    return best


def _improve(
    x: NDArray[np.complex128],
    array: LineArray,
    axis: NDArray[np.float64],
    best: NDArray[np.float64],
    left: NDArray[np.float64],
) -> None:
    """Search any two of three or more lines anew beside the others, in place, until no two of a row go elsewhere."""
    twos = list(combinations(range(best.shape[1]), 2))
    going = np.arange(len(x))
    for _ in range(CYCLES):
        before = left[going]
        for two in twos:
            others = np.delete(best[going], two, axis=1)
            trials = pairs_elsewhere(x[going], array, axis, others, others[:, :0], PAIRS)
            found, energy = raced(x[going], trials, array, RACE)
            better = energy[:, 0] < left[going]
            improved = going[better]
            best[improved], left[improved] = refit(x[improved], found[better, 0], array)
        going = going[left[going] < before * (1.0 - GAIN)]
        if not len(going):
            break


def _best_pair(x: NDArray[np.complex128], array: LineArray, axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """[B, 2] the pair that explains most of x: all pairs of grid angles are tried, the best few refined.

    The overlap of :func:`trainer.estimators.lines.pair_energy` depends on the distance of the two angles alone, so that
    all pairs of one distance are done at once. The best of one distance is one candidate; its neighbours, half a grid
    step away, are refined to the same optimum.
    """
    matched = x @ array.manifold(axis).conj() / np.sqrt(array.channels)  # (B, N)
    overlap = np.mean(array.manifold(axis - axis[0]), axis=0)  # (N,)
    most = np.zeros((len(x), len(axis)))
    where = np.zeros((len(x), len(axis)), dtype=np.intp)
    for distance in range(1, len(axis)):
        explained = pair_energy(matched[:, :-distance], matched[:, distance:], overlap[[distance]])
        where[:, distance] = np.argmax(explained, axis=1)
        most[:, distance] = explained.max(axis=1)
    rows = np.arange(len(x))
    pair, least = np.zeros((len(x), 2)), np.full(len(x), np.inf)
    for _ in range(CANDIDATES):
        distance = np.argmax(most, axis=1)
        first = where[rows, distance]
        trial = refine_lines(x, np.stack([axis[first], axis[first + distance]], axis=1), array)
        left = np.linalg.norm(line_amplitudes(x, trial, array)[1], axis=1)
        better = left < least
        pair[better], least[better] = trial[better], left[better]
        near = np.abs(np.arange(len(axis)) - distance[:, None]) <= 1
        most[near] = 0.0
    return pair
