"""Lines at continuous angles: least squares for their amplitudes, Gauss-Newton for their angles.

With A = [a(u_1) .. a(u_K)] the amplitudes of least squares are s = A^+ x and what they leave is P x, P = I - A A^+.
Moving the angles by d changes what is left by -P D diag(s) d + O(d^2), D = dA/du, so that the step of least squares
is

    d = Re[(P D diag(s))^H (P D diag(s))]^-1 Re[(P D diag(s))^H x]

(Golub and Pereyra 1973 in the form of Kaufman 1975; the matrix is the Fisher information of Stoica and Nehorai 1989
times half the noise power).
"""

from __future__ import annotations

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
    """[B, K] Levenberg's step from the lines u."""
    curvature, slope = _jacobian_products(x, u, array)
    diagonal = np.arange(u.shape[1])
    own = curvature[:, diagonal, diagonal]
    # A line without amplitude has no curvature, and no step.
    floor = np.maximum(RIDGE * own.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    curvature[:, diagonal, diagonal] = own * (1.0 + damping[:, None]) + floor
    return np.asarray(np.linalg.solve(curvature, slope[..., None])[..., 0], dtype=np.float64)


def _jacobian_products(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(Re[J^H J] [B, K, K], Re[J^H x] [B, K]) with J = P D diag(s) of the lines u."""
    atoms = _atoms(u, array)
    amplitude, left = _least_squares(x, atoms)
    moved = -2j * np.pi / array.wavelength_m * array.positions_m[:, None] * atoms
    jacobian = (moved - atoms @ _normal_solve(atoms, moved)) * amplitude[:, None, :]
    adjoint = np.swapaxes(jacobian, 1, 2).conj()
    return (adjoint @ jacobian).real, (adjoint @ left[..., None])[..., 0].real


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
