"""Lines at continuous angles: least squares for their amplitudes, Gauss-Newton for their angles.

With A = [a(u_1) .. a(u_K)] the amplitudes of least squares are s = A^+ x and what they leave is P x, P = I - A A^+.
Moving the angles by d changes what is left by -P D diag(s) d + O(d^2), D = dA/du, so that the step of least squares
is

    d = Re[(P D diag(s))^H (P D diag(s))]^-1 Re[(P D diag(s))^H x]

(Golub and Pereyra 1973 in the form of Kaufman 1975; the matrix is the Fisher information of Stoica and Nehorai 1989
times half the noise power).

Moves change a set of lines, by adding one or putting two elsewhere: lines u [B, K] become trials [B, T, L].
:func:`best_refit` refines all trials and keeps the one that leaves least of the snapshot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray

SEPARABLE = 0.05
"""Least eigenvalue of A^H A / C, of normed lines, whose part of the amplitudes is told: none then has more than 4.5 =
1 / sqrt(0.05) times the standard error of a lone line's. Two lines d apart have the eigenvalues 1 +- |g|, where 1 - |g|
is about (k std(p) d)^2 / 2: on a filled array that is a distance of 0.17 resolution cells, and nearer ones share their
sum."""
RIDGE = 1e-12
"""On the diagonal of A^H A / C: two lines at one angle share its amplitude instead of failing."""
STEPS = 12
LARGEST_STEP, SETTLED = 0.25, 1e-6
"""Of a resolution cell, or a bin: farther than the one the linear step is no guide, below the other it changes
nothing."""
FIRST_DAMPING, DAMPING_FACTOR, LEAST_DAMPING, MOST_DAMPING = 1e-3, 10.0, 1e-9, 1e9
"""Levenberg's, relative to the diagonal: a rejected step raises it, an accepted one lowers it."""


def line_amplitudes(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(least-squares amplitudes [B, K], what they leave of x [B, C]) of snapshots x [B, C] and lines u [B, K]."""
    return _least_squares(x, _atoms(u, array))


def bounded_amplitudes(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(amplitudes [B, K], what they leave of x [B, C]) by least squares without the directions that noise decides.

    A^H A = V diag(l) V^H, s = sum over l_k >= SEPARABLE C of v_k v_k^H A^H x / l_k: the truncated singular value
    decomposition (Hansen, BIT 27, 1987). Nearly coincident lines may otherwise cancel each other at any amplitude: two
    of them fit the derivative of a manifold vector, and with it any error of calibration around a strong echo.
    """
    atoms = _atoms(u, array)
    adjoint = np.swapaxes(atoms, 1, 2).conj()
    eigenvalues, vectors = np.linalg.eigh(adjoint @ atoms)
    kept = eigenvalues >= SEPARABLE * array.channels
    parts = (np.swapaxes(vectors, 1, 2).conj() @ (adjoint @ x[..., None]))[..., 0]
    parts = np.where(kept, parts / np.where(kept, eigenvalues, 1.0), 0.0)
    amplitude = (vectors @ parts[..., None])[..., 0]
    return amplitude, x - (atoms @ amplitude[..., None])[..., 0]


def line_energy_left(x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray) -> NDArray[np.float64]:
    """[B] energy that lines u [B, K] leave of snapshots x [B, C] by least squares."""
    return _energy(line_amplitudes(x, u, array)[1])


def bounded_energy_left(x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray) -> NDArray[np.float64]:
    """[B] energy that they leave with bounded amplitudes: nothing is won by lines that cancel each other."""
    return _energy(bounded_amplitudes(x, u, array)[1])


def refine_lines(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray, steps: int = STEPS
) -> NDArray[np.float64]:
    """[B, K] angles of a local optimum of ||P x|| near u [B, K], jointly in all lines; never a worse one."""
    best, damping = u.copy(), np.full(len(x), FIRST_DAMPING)
    cost = _energy(_least_squares(x, _atoms(u, array))[1])
    reach, settled = LARGEST_STEP * array.resolution_cell, SETTLED * array.resolution_cell
    going = np.arange(len(x) if u.shape[1] else 0)
    for _ in range(steps):
        step = np.clip(_damped_step(x[going], best[going], array, damping[going]), -reach, reach)
        trial = best[going] + step
        trial_cost = _energy(_least_squares(x[going], _atoms(trial, array))[1])
        better = trial_cost < cost[going]
        best[going[better]], cost[going[better]] = trial[better], trial_cost[better]
        factor = np.where(better, 1.0 / DAMPING_FACTOR, DAMPING_FACTOR)
        damping[going] = np.clip(damping[going] * factor, LEAST_DAMPING, MOST_DAMPING)
        going = going[np.abs(step).max(axis=1) > settled]
        if not len(going):
            break
    return best


def _damped_step(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray, damping: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[B, K] Levenberg's step from the lines u, by the curvature J^H J and the slope J^H x with J = P D diag(s)."""
    atoms = _atoms(u, array)
    amplitude, left = _least_squares(x, atoms)
    moved = -2j * np.pi / array.wavelength_m * array.positions_m[:, None] * atoms
    jacobian = (moved - atoms @ _normal_solve(atoms, moved)) * amplitude[:, None, :]
    adjoint = np.swapaxes(jacobian, 1, 2).conj()
    curvature, slope = (adjoint @ jacobian).real, (adjoint @ left[..., None])[..., 0].real
    diagonal = np.arange(u.shape[1])
    own = curvature[:, diagonal, diagonal]
    # A line without amplitude has no curvature, and no step.
    floor = np.maximum(RIDGE * own.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    curvature[:, diagonal, diagonal] = own * (1.0 + damping[:, None]) + floor
    return np.asarray(np.linalg.solve(curvature, slope[..., None])[..., 0], dtype=np.float64)


def _least_squares(
    x: NDArray[np.complex128], atoms: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(amplitudes [B, K], what they leave of x [B, C]) for atoms [B, C, K]."""
    amplitude = _normal_solve(atoms, x[..., None])[..., 0]
    return amplitude, x - (atoms @ amplitude[..., None])[..., 0]


def _atoms(u: NDArray[np.float64], array: LineArray) -> NDArray[np.complex128]:
    """[B, C, K] manifold vectors of the lines u [B, K]."""
    return np.ascontiguousarray(np.moveaxis(array.manifold(u), 0, 1))


def _normal_solve(atoms: NDArray[np.complex128], right: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """[B, K, M] least-squares solutions of atoms [B, C, K] times it = right [B, C, M]."""
    adjoint = np.swapaxes(atoms, -1, -2).conj()
    gram = adjoint @ atoms
    diagonal = np.arange(atoms.shape[-1])
    gram[:, diagonal, diagonal] += RIDGE * atoms.shape[-2]
    return np.asarray(np.linalg.solve(gram, adjoint @ right), dtype=np.complex128)


def _energy(x: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.sum(x.real**2 + x.imag**2, axis=-1)


CLOSEST = 1e-9
"""Smallest part of a manifold vector outside the span of others that can still be told from rounding."""
LEAST_APART = 1e-4
"""Least 1 - |g|^2 of a pair that single precision tells."""
NEAR_CELLS = 0.2
"""Angles so near are refined to the same ones. With 0.5 four in a hundred pairs of 12 channels half a cell apart at
20 dB end at a wrong optimum, with 0.2 none more than of an exhaustive search."""
KEPT_ANGLES = 48
"""Of a row, of which all pairs are tried."""

EnergyLeft = Callable[[NDArray[np.complex128], NDArray[np.float64], LineArray], NDArray[np.float64]]
"""What lines [B, K] leave of snapshots [B, C]: the energies [B]."""


def additions(
    x: NDArray[np.complex128], array: LineArray, axis: NDArray[np.float64], u: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """[B, count, K + 1] the lines u [B, K] with each of the ``count`` angles that explain most of what they leave.

    The score is |a^H P x|^2 / a^H P a with P the projection off the span of the lines; an angle of ``axis`` inside that
    span counts 0. Only its local maxima are taken.
    """
    score = beside_lines(x, array, axis, u)[0]
    before, after = np.roll(score, 1, axis=1), np.roll(score, -1, axis=1)
    score = np.where((score >= before) & (score > after), score, 0.0)
    best = np.argsort(-score, axis=1, kind="stable")[:, :count]
    kept = np.repeat(u[:, None, :], best.shape[1], axis=1)
    return np.concatenate([kept, axis[best][..., None]], axis=2)


def pairs_elsewhere(
    x: NDArray[np.complex128],
    array: LineArray,
    axis: NDArray[np.float64],
    u: NDArray[np.float64],
    avoided: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    """[B, count, K + 2] the lines u [B, K], K from 0, and the pairs of angles that explain most of what they leave.

    Of the :data:`KEPT_ANGLES` angles that would explain most alone all pairs are tried, see :func:`pair_energy`. A pair
    is left out where both its angles are within :data:`NEAR_CELLS` of lines ``avoided`` [B, A], or of a better pair.

    :param axis: uniform
    """
    kept = min(KEPT_ANGLES, len(axis))
    alone, matched, inside = beside_lines(x, array, axis, u)
    place = np.sort(np.argpartition(-alone, kept - 1, axis=1)[:, :kept], axis=1)  # (B, M)
    first, second = np.triu_indices(kept, 1)
    overlap = array.manifold((axis[1] - axis[0]) * np.arange(len(axis))).mean(axis=0).astype(np.complex64)
    gram = overlap[place[:, second] - place[:, first]]  # (B, P)
    matched = np.take_along_axis(matched, place, axis=1).astype(np.complex64)
    if u.shape[1]:
        inside = np.take_along_axis(inside, place[:, None, :], axis=2).astype(np.complex64)  # (B, K, M)
        gram = gram - np.sum(inside[:, :, first].conj() * inside[:, :, second], axis=1)
        norm = np.sqrt(np.maximum(1.0 - np.sum(np.abs(inside) ** 2, axis=1), LEAST_APART))
        gram /= norm[:, first] * norm[:, second]
        matched /= norm
    energy = pair_energy(matched[:, first], matched[:, second], gram)
    near = NEAR_CELLS * array.resolution_cell
    angle = axis[place]
    if avoided.shape[1]:
        occupied = np.asarray((np.abs(angle[:, :, None] - avoided[:, None, :]) < near).any(axis=2))
        energy[occupied[:, first] & occupied[:, second]] = 0.0
    rows, found = np.arange(len(x)), np.empty((len(x), count, 2))
    for index in range(count):
        best = np.argmax(energy, axis=1)
        found[:, index] = np.stack([angle[rows, first[best]], angle[rows, second[best]]], axis=1)
        if index + 1 < count:
            close = np.asarray(np.abs(angle[:, None, :] - found[:, index, :, None]) < near)  # (B, 2, M)
            energy[close[:, 0, first] & close[:, 1, second]] = 0.0
    return np.concatenate([np.repeat(u[:, None, :], count, axis=1), found], axis=2)


def pair_energy(
    first: NDArray[np.complexfloating], second: NDArray[np.complexfloating], overlap: NDArray[np.complexfloating]
) -> NDArray[np.floating]:
    """Energy of the projection on pairs of angles, (|b_i|^2 + |b_j|^2 - 2 Re(b_i* g b_j)) / (1 - |g|^2).

    :param first, second: b = a^H x / |a|, a the manifold vectors
    :param overlap: g = a_i^H a_j / (|a_i| |a_j|); pairs that coincide count 0
    """
    apart = 1.0 - (overlap.real**2 + overlap.imag**2)
    cross = first.conj() * second
    power = first.real**2 + first.imag**2 + second.real**2 + second.imag**2
    joint = power - 2.0 * (cross.real * overlap.real - cross.imag * overlap.imag)
    told = apart > LEAST_APART
    return np.where(told, joint / np.where(told, apart, 1.0), 0.0)


def beside_lines(
    x: NDArray[np.complex128], array: LineArray, axis: NDArray[np.float64], u: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.complex128]]:
    """What a further line at each angle of ``axis`` [N] meets beside the lines u [B, K]; P projects off their span.

    :return: [B, N] energy that it takes, |a^H P x|^2 / a^H P a; [B, N] a^H P x / |a|; [B, K, N] Q^H a / |a|, Q an
        orthonormal basis of the span
    """
    atoms = array.manifold(axis) / np.sqrt(array.channels)
    if not u.shape[1]:
        matched = x @ atoms.conj()
        return np.abs(matched) ** 2, matched, np.empty((len(x), 0, len(axis)), dtype=np.complex128)
    basis, _ = np.linalg.qr(np.moveaxis(array.manifold(u), 0, 1))
    adjoint = np.swapaxes(basis, 1, 2).conj()
    matched = (x - (basis @ (adjoint @ x[..., None]))[..., 0]) @ atoms.conj()
    inside = adjoint @ atoms
    outside = np.maximum(1.0 - np.sum(np.abs(inside) ** 2, axis=1), 0.0)
    tested = outside > CLOSEST
    return np.where(tested, np.abs(matched) ** 2 / np.where(tested, outside, 1.0), 0.0), matched, inside


def best_refit(
    x: NDArray[np.complex128],
    trials: NDArray[np.float64],
    array: LineArray,
    measure: EnergyLeft = line_energy_left,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """([B, L] the refined trial that leaves least of x, [B] that energy) of trials [B, T, L], by ``measure``."""
    found, left = raced(x, trials, array, ((STEPS, 1),), measure)
    return found[:, 0], left[:, 0]


def raced(
    x: NDArray[np.complex128],
    trials: NDArray[np.float64],
    array: LineArray,
    stages: Sequence[tuple[int, int]],
    measure: EnergyLeft = line_energy_left,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """([B, T', L] the best of trials [B, T, L], best first, [B, T'] the energy they leave).

    Each of the ``stages`` (steps, kept) refines all that are left by some steps and keeps the best: what a wrong
    optimum leaves is seen before it is reached.
    """
    left = np.empty((len(x), 0))
    for steps, kept in stages:
        rows, count, lines = trials.shape
        refined, energy = refit(np.repeat(x, count, axis=0), trials.reshape(rows * count, lines), array, steps, measure)
        order = np.argsort(energy.reshape(rows, count), axis=1, kind="stable")[:, :kept]
        trials = np.take_along_axis(refined.reshape(rows, count, lines), order[..., None], axis=1)
        left = np.take_along_axis(energy.reshape(rows, count), order, axis=1)
    return trials, left


def refit(
    x: NDArray[np.complex128],
    u: NDArray[np.float64],
    array: LineArray,
    steps: int = STEPS,
    measure: EnergyLeft = line_energy_left,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(lines u [B, K] refined, [B] energy they leave by ``measure``); a row that it would leave worse stays."""
    refined, before = refine_lines(x, u, array, steps), measure(x, u, array)
    after = measure(x, refined, array)
    worse = after > before
    refined[worse] = u[worse]
    return refined, np.where(worse, before, after)
