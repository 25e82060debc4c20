"""Maximum likelihood for a known number of targets: the ceiling for any estimator that is not told more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.estimators.array import ROWS_AT_ONCE, LineArray, check_snapshots, draw_lines, image_rows, uniform_axis
from trainer.estimators.lines import bounded_amplitudes, line_amplitudes, refine_lines

SEARCH_POINTS, CANDIDATES = 6, 8
"""Angles searched in a resolution cell, and pairs refined: of 6 400 random pairs (10 and 30 dB, 0.25 to 3.3 cells, 18
and 12 channels) none ended worse than a refinement from the truth; with 4 and 6 it was 0.2 %, with one candidate
4 %."""
CYCLES = 3
"""Rounds in which each of three or more lines is searched anew beside the others."""
CLOSEST = 1e-9
"""Smallest part of a manifold vector outside the span of others that can still be told from rounding."""


class MaximumLikelihood:
    """The K angles whose manifold vectors leave least of the snapshot: min ||x - A s||^2 over u and s, s = A^+ x.

    Deterministic maximum likelihood in white Gaussian noise (Stoica and Nehorai 1989); efficient above its threshold
    SNR. All pairs of a grid are tried, further lines are added by alternating projection (Ziskind and Wax 1988), and
    Gauss-Newton steps leave the grid. For K = 1 and 2 the search is exhaustive; for more it may stop at a local
    optimum. It is told K: an image that beats it clearly knows something else as well.

    Told of more targets than there are, of noise alone for instance, the best angles may be two that all but coincide,
    with amplitudes a thousand times the noise that cancel. The angles stay those of the likelihood; the amplitudes are
    bounded, see :func:`trainer.estimators.lines.bounded_amplitudes`: lines too close to be told apart share their sum.

    :param targets: K, in every range bin
    :raises InputError: less than one target
    """

    name = "ml"

    def __init__(self, targets: int = 2) -> None:
        if targets < 1:
            raise InputError("ml", f"targets = {targets!r}", "a whole number of at least 1")
        self.targets = targets

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: float
    ) -> NDArray[np.float64]:
        """[R, U] K lines a row with their magnitudes [sqrt(W)], each in its nearest bin of u [U]."""
        _check_count(self.targets, array)

        def solve(x: NDArray[np.complex128], _: NDArray[np.float64]) -> NDArray[np.float64]:
            found = _search(x, array, self.targets)
            amplitude, _left = bounded_amplitudes(x, found, array)
            return draw_lines(found, np.abs(amplitude), array, u)

        return image_rows(snapshots, array, len(u), noise_power, solve)

    def locate(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, targets: int | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """(u [R, K] rising, complex amplitudes [R, K] [sqrt(W)]); zeros where the snapshot is zero.

        :param snapshots: [R, C] [sqrt(W)]
        :param targets: K, by default that of the estimator
        :raises InputError: K less than 1, or so many that they explain any snapshot
        """
        count = self.targets if targets is None else targets
        _check_count(count, array)
        check_snapshots(snapshots, array)
        found = np.zeros((len(snapshots), count))
        amplitude = np.zeros((len(snapshots), count), dtype=np.complex128)
        rows = np.asarray(snapshots, dtype=np.complex128)
        scale = np.abs(rows).max(axis=1)
        present = np.flatnonzero(scale > 0.0)
        for start in range(0, len(present), ROWS_AT_ONCE):
            block = present[start : start + ROWS_AT_ONCE]
            x = rows[block] / scale[block, None]
            found[block] = np.sort(_search(x, array, count), axis=1)
            amplitude[block] = scale[block, None] * bounded_amplitudes(x, found[block], array)[0]
        return found, amplitude


def _check_count(targets: int, array: LineArray) -> None:
    if not 1 <= targets < max(array.channels, 2):
        raise InputError("ml", f"targets = {targets} with {array.channels} channels", "1 or more, fewer than channels")


def _search(x: NDArray[np.complex128], array: LineArray, targets: int) -> NDArray[np.float64]:
    """[B, K] angles, within one period of u."""
    axis = uniform_axis(array, SEARCH_POINTS)
    if targets == 1:
        found = axis[np.argmax(np.abs(x @ array.manifold(axis).conj()), axis=1)][:, None]
    else:
        found = _best_pair(x, array, axis)
    for _ in range(2, targets):
        found = np.concatenate([found, _best_addition(x, array, axis, found)[:, None]], axis=1)
        found = refine_lines(x, found, array)
    for _ in range(CYCLES if targets > 2 else 0):
        for line in range(targets):
            others = np.delete(found, line, axis=1)
            trial = found.copy()
            trial[:, line] = _best_addition(x, array, axis, others)
            trial = refine_lines(x, trial, array)
            left_before = np.linalg.norm(line_amplitudes(x, found, array)[1], axis=1)
            left_after = np.linalg.norm(line_amplitudes(x, trial, array)[1], axis=1)
            better = left_after < left_before
            found[better] = trial[better]
    found = refine_lines(x, found, array)
    half = array.half_period
    return (found + half) % (2.0 * half) - half if half < 1.0 else np.clip(found, -1.0, 1.0)


def _best_pair(x: NDArray[np.complex128], array: LineArray, axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """[B, 2] the pair that explains most of x: all pairs of grid angles are tried, the best few refined.

    With b = A^H x / sqrt(C) and g = a_i^H a_j / C the energy of the projection on a pair is

        (|b_i|^2 + |b_j|^2 - 2 Re(b_i* g b_j)) / (1 - |g|^2),

    and g depends on the distance of the two angles alone, so that all pairs of one distance are done at once. The
    best of one distance is one candidate; its neighbours, half a grid step away, are refined to the same optimum.
    """
    matched = x @ array.manifold(axis).conj() / np.sqrt(array.channels)  # (B, N)
    power = matched.real**2 + matched.imag**2
    overlap = np.mean(array.manifold(axis - axis[0]), axis=0)  # (N,)
    most = np.zeros((len(x), len(axis)))
    where = np.zeros((len(x), len(axis)), dtype=np.intp)
    for distance in range(1, len(axis)):
        apart = 1.0 - abs(overlap[distance]) ** 2
        if apart < CLOSEST:
            continue
        cross = matched[:, :-distance].conj() * matched[:, distance:]
        both = 2.0 * (cross.real * overlap[distance].real - cross.imag * overlap[distance].imag)
        explained = (power[:, :-distance] + power[:, distance:] - both) / apart
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


def _best_addition(
    x: NDArray[np.complex128], array: LineArray, axis: NDArray[np.float64], found: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[B] the grid angle that explains most of what the lines ``found`` [B, K] leave of x.

    |a^H P x|^2 / a^H P a with P the projection off the span of the lines found; a grid angle inside that span counts 0.
    """
    manifold = array.manifold(axis)
    lines = np.moveaxis(array.manifold(found), 0, 1)
    basis, _ = np.linalg.qr(lines)
    left = x - np.einsum("bck,bdk,bd->bc", basis, basis.conj(), x)
    inside = np.abs(np.swapaxes(basis, 1, 2).conj() @ manifold) ** 2
    outside = np.maximum(array.channels - inside.sum(axis=1), 0.0)
    explained = np.abs(left @ manifold.conj()) ** 2
    tested = outside > CLOSEST * array.channels
    score = np.where(tested, explained / np.where(tested, outside, 1.0), 0.0)
    return axis[np.argmax(score, axis=1)]
