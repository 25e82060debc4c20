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

RIDGE = 1e-12
"""On the diagonal of A^H A / C: two lines at one angle share its amplitude instead of failing."""
STEPS = 12
LARGEST_STEP = 0.25
"""Of a resolution cell: farther than that the linear step is no guide."""
FIRST_DAMPING, DAMPING_FACTOR, DAMPING_RANGE = 1e-3, 10.0, (1e-9, 1e9)
"""Levenberg's, relative to the diagonal: a rejected step raises it, an accepted one lowers it."""


def line_amplitudes(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(least-squares amplitudes [B, K], what they leave of x [B, C]) of snapshots x [B, C] and lines u [B, K]."""
    atoms = _atoms(u, array)
    amplitude = _normal_solve(atoms, x[..., None])[..., 0]
    return amplitude, x - np.einsum("bck,bk->bc", atoms, amplitude)


def refine_lines(
    x: NDArray[np.complex128], u: NDArray[np.float64], array: LineArray, steps: int = STEPS
) -> NDArray[np.float64]:
    """[B, K] angles of a local optimum of ||P x|| near u [B, K], jointly in all lines; never a worse one."""
    derivative = -2j * np.pi / array.wavelength_m * array.positions_m[:, None]
    best = u.copy()
    amplitude, left = line_amplitudes(x, best, array)
    cost = _energy(left)
    damping = np.full(len(x), FIRST_DAMPING)
    diagonal = np.arange(u.shape[1])
    for _ in range(steps):
        atoms = _atoms(best, array)
        moved = derivative * atoms
        jacobian = (moved - atoms @ _normal_solve(atoms, moved)) * amplitude[:, None, :]
        curvature = np.einsum("bcj,bck->bjk", jacobian.conj(), jacobian).real
        slope = np.einsum("bck,bc->bk", jacobian.conj(), left).real
        own = curvature[:, diagonal, diagonal]
        # A line without amplitude has no curvature and stays where it is.
        floor = np.maximum(RIDGE * own.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
        curvature[:, diagonal, diagonal] = own * (1.0 + damping[:, None]) + floor
        step = np.linalg.solve(curvature, slope[..., None])[..., 0]
        reach = LARGEST_STEP * array.resolution
        trial = best + np.clip(step, -reach, reach)
        trial_amplitude, trial_left = line_amplitudes(x, trial, array)
        better = _energy(trial_left) < cost
        best[better], amplitude[better], left[better] = trial[better], trial_amplitude[better], trial_left[better]
        cost = _energy(left)
        damping = np.clip(np.where(better, damping / DAMPING_FACTOR, damping * DAMPING_FACTOR), *DAMPING_RANGE)
    return best


def _atoms(u: NDArray[np.float64], array: LineArray) -> NDArray[np.complex128]:
    """[B, C, K] manifold vectors of the lines u [B, K]."""
    return np.moveaxis(array.manifold(u), 0, 1)


def _normal_solve(atoms: NDArray[np.complex128], right: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """[B, K, M] least-squares solutions of atoms [B, C, K] times it = right [B, C, M]."""
    adjoint = np.swapaxes(atoms, -1, -2).conj()
    gram = adjoint @ atoms
    diagonal = np.arange(atoms.shape[-1])
    gram[:, diagonal, diagonal] += RIDGE * atoms.shape[-2]
    return np.asarray(np.linalg.solve(gram, adjoint @ right), dtype=np.complex128)


def _energy(x: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.sum(x.real**2 + x.imag**2, axis=-1)
