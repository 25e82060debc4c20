"""Algebra of small matrices for compiled kernels, on arrays of the caller: their first ``size`` rows count."""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled, inlined

JACOBI_SWEEPS, JACOBI_ZERO = 12, 1e-12
"""Until no element beside the diagonal of a normed Gram matrix is larger."""
part = compiled(cache=False, error_model="numpy")
"""Of :func:`trainer.estimators.groups.fit_in_turn`. Slices are copied by loops and sorted by hand, and constants are
typed: numba's own slices and sorts, and the copies of a function that it makes for each constant it is called with,
take minutes to compile."""
part_of_one = compiled(cache=False, error_model="numpy", inline="always")
"""A part that is called at one place, as lines of its caller: each part's machine code is made with that of all that it
calls, level by level. With ten such parts the fit compiles in 33 s instead of 50: what the benchmark says a frame takes
(``NUMBA_CACHE_DIR=build/kernels python tests/benchmarks/points.py --frames 1``), with and without ``inline``."""


@inlined(error_model="numpy")
def scaled(value, factor):
    """Times a real number: numba's own operators would make it complex, and its divisions careful and slow."""
    return complex(value.real * factor, value.imag * factor)


@part
def cholesky(matrix, size):
    """Factor a Hermitian matrix in place, its lower triangle; False where it is not positive definite. The diagonal
    is the inverse of L's: it only ever divides."""
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * np.conj(matrix[j, k])
            if j < i:
                matrix[i, j] = scaled(total, matrix[j, j].real)
            elif total.real > 0.0:
                matrix[i, i] = 1.0 / np.sqrt(total.real)
            else:
                return False
    return True


@part
def forward(factor, size, vector):
    """vector := L^-1 vector."""
    for i in range(size):
        total = vector[i]
        for k in range(i):
            total -= factor[i, k] * vector[k]
        vector[i] = scaled(total, factor[i, i].real)


@part
def backward(factor, size, vector):
    """vector := L^-H vector."""
    for i in range(size - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, size):
            total -= np.conj(factor[k, i]) * vector[k]
        vector[i] = scaled(total, factor[i, i].real)


@part
def eigen(matrix, vectors, size):
    """Jacobi's rotations of a Hermitian matrix, in place: its eigenvalues on the diagonal, vectors in the columns."""
    for i in range(size):
        for j in range(size):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(JACOBI_SWEEPS):
        beside = 0.0
        for p in range(size):
            for q in range(p + 1, size):
                norm = np.sqrt(matrix[p, q].real ** 2 + matrix[p, q].imag ** 2)
                beside = max(beside, norm)
                if norm < JACOBI_ZERO:
                    continue
                turn = matrix[p, q] / norm
                ratio = (matrix[q, q].real - matrix[p, p].real) / (2.0 * norm)
                tangent = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + np.sqrt(ratio**2 + 1.0))
                cosine = 1.0 / np.sqrt(tangent**2 + 1.0)
                sine = tangent * cosine * turn
                for k in range(size):
                    a, b = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = cosine * a - np.conj(sine) * b, sine * a + cosine * b
                    a, b = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = cosine * a - np.conj(sine) * b, sine * a + cosine * b
                for k in range(size):
                    a, b = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = cosine * a - sine * b, np.conj(sine) * a + cosine * b
        if beside < JACOBI_ZERO:
            break


@part
def solve(matrix, vector, size):
    """Solve a symmetric positive definite system in place, by the upper triangle; False where it is not. The inner
    loops run along rows, several elements at once."""
    for k in range(size):
        if not matrix[k, k] > 0.0:
            return False
        matrix[k, k] = 1.0 / np.sqrt(matrix[k, k])
        for j in range(k + 1, size):
            matrix[k, j] *= matrix[k, k]
        for i in range(k + 1, size):
            factor = matrix[k, i]
            for j in range(i, size):
                matrix[i, j] -= factor * matrix[k, j]
    for k in range(size):
        vector[k] *= matrix[k, k]
        value = vector[k]
        for j in range(k + 1, size):
            vector[j] -= value * matrix[k, j]
    for i in range(size - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, size):
            total -= matrix[i, k] * vector[k]
        vector[i] = total * matrix[i, i]
    return True
