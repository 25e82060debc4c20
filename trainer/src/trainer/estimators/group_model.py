"""Least squares of a group of range-Doppler cells: amplitudes, what is left, how well it is told.

The equations stand in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

import numpy as np

from trainer.estimators.group_products import ZERO, differentiate, evaluate
from trainer.estimators.lines import RIDGE, SEPARABLE
from trainer.estimators.small_matrices import backward, cholesky, eigen, forward, part, part_of_one, scaled, solve


@part
def _solved(work, lines):
    """The energy that lines explain whose Gram matrix stands in ``work.factor``, and A^H x in ``work.amplitude``;
    leaves the Cholesky factor and the amplitudes there."""
    factor, amplitude = work.factor, work.amplitude
    cholesky(factor, lines)
    forward(factor, lines, amplitude)
    explained = 0.0
    for i in range(lines):
        explained += amplitude[i].real ** 2 + amplitude[i].imag ** 2
    backward(factor, lines, amplitude)
    return explained


@part
def least_squares(work, which, wide, lines):
    """The energy that the lines explain; leaves their amplitudes and the Cholesky factor of their Gram matrix."""
    gram, factor = work.gram, work.factor
    for i in range(lines):
        for j in range(i + 1):
            factor[i, j] = gram[which, i * wide, j * wide]
        factor[i, i] = factor[i, i] * (1.0 + RIDGE) + RIDGE
        work.amplitude[i] = work.right[which, i * wide]
    return _solved(work, lines)


@part
def bounded(work, which, wide, lines, left_out):
    """Amplitudes without the directions that noise decides, and the energy that they explain.

    :param lines: how many take part: all but ``left_out``, which is ``lines`` for none
    """
    gram, factor, amplitude = work.gram, work.factor, work.amplitude
    norm, column = np.empty(lines), np.empty(lines, dtype=np.int64)
    for i in range(lines):
        column[i] = (i if i < left_out else i + 1) * wide
        norm[i] = 1.0 / np.sqrt(max(gram[which, column[i], column[i]].real, 1e-300))
        amplitude[i] = work.right[which, column[i]]
    # Where all eigenvalues of the normed Gram matrix are above SEPARABLE nothing is left out.
    for i in range(lines):
        for j in range(i):
            factor[i, j] = scaled(gram[which, column[i], column[j]], norm[i] * norm[j])
        factor[i, i] = 1.0 - SEPARABLE
    if cholesky(factor, lines):
        for i in range(lines):
            for j in range(i + 1):
                factor[i, j] = gram[which, column[i], column[j]]
        return _solved(work, lines)
    normed, vectors = np.empty((2, lines, lines), dtype=np.complex128)
    for i in range(lines):
        for j in range(i):
            normed[i, j] = scaled(gram[which, column[i], column[j]], norm[i] * norm[j])
            normed[j, i] = np.conj(normed[i, j])
        normed[i, i] = 1.0
        amplitude[i] = 0.0
    eigen(normed, vectors, lines)
    explained = 0.0
    for j in range(lines):
        if normed[j, j].real >= SEPARABLE:
            along = 0.0j
            for i in range(lines):
                along += np.conj(vectors[i, j]) * scaled(work.right[which, column[i]], norm[i])
            explained += (along.real**2 + along.imag**2) / normed[j, j].real
            for i in range(lines):
                amplitude[i] += vectors[i, j] * scaled(along, norm[i] / normed[j, j].real)
    return explained


@part
def information(work, which, wide, lines):
    """Curvature Re[J^H J], its upper triangle, and slope Re[J^H x] of all free coordinates, from the factor and
    amplitudes in ``work``."""
    gram, amplitude, factor, mixed, curvature = work.gram, work.amplitude, work.factor, work.mixed, work.curvature
    size = lines * (wide - 1)
    for a in range(size):
        line, column = a // (wide - 1), a // (wide - 1) * wide + 1 + a % (wide - 1)
        # What is left of x is orthogonal to A.
        residual = work.right[which, column]
        for k in range(lines):
            own = gram[which, column, k * wide] if k <= line else np.conj(gram[which, k * wide, column])
            residual -= own * amplitude[k]
            own = np.conj(own) * amplitude[line]
            mixed[0, k, a], mixed[1, k, a] = own.real, own.imag
        work.slope[a] = (np.conj(amplitude[line]) * residual).real
        for b in range(a + 1):
            other, beside = b // (wide - 1), b // (wide - 1) * wide + 1 + b % (wide - 1)
            curvature[b, a] = (gram[which, column, beside] * np.conj(amplitude[line]) * amplitude[other]).real
    # mixed := L^-1 A^H D diag(s)
    for k in range(lines):
        for j in range(k):
            real, imaginary = factor[k, j].real, factor[k, j].imag
            for a in range(size):
                mixed[0, k, a] -= real * mixed[0, j, a] - imaginary * mixed[1, j, a]
                mixed[1, k, a] -= real * mixed[1, j, a] + imaginary * mixed[0, j, a]
        inverse = factor[k, k].real
        for a in range(size):
            mixed[0, k, a] *= inverse
            mixed[1, k, a] *= inverse
        for a in range(size):
            real, imaginary = mixed[0, k, a], mixed[1, k, a]
            for b in range(a, size):
                curvature[a, b] -= real * mixed[0, k, b] + imaginary * mixed[1, k, b]
    return size


@part
def energy_left(model, group, place, lines, work):
    """Energy that lines at ``place`` leave with bounded amplitudes; set 0 of ``work`` is theirs."""
    evaluate(model, group, place, lines, work, ZERO)
    return max(group.energy - bounded(work, ZERO, 1 + group.coordinates, lines, lines), 0.0)


@part_of_one
def describe(model, group, place, lines, work, amplitude, deviation):
    """Bounded amplitudes [K] and Cramer-Rao deviations [K, 2] of the lines."""
    wide = 1 + group.coordinates
    evaluate(model, group, place, lines, work, ZERO)
    differentiate(model, wide, lines, work, ZERO)
    least_squares(work, ZERO, wide, lines)
    size = information(work, ZERO, wide, lines)
    scale, matrix, column = np.empty(size), np.empty((size, size)), np.empty(size)
    for a in range(size):
        # Elements at one place say nothing of an angle, but for rounding.
        scale[a] = 1.0 / np.sqrt(max(work.curvature[a, a], RIDGE * (2.0 * np.pi) ** 2 * group.energy))
    for a in range(size):
        for i in range(size):
            for j in range(i, size):
                matrix[i, j] = work.curvature[i, j] * scale[i] * scale[j]
            matrix[i, i] += RIDGE
            column[i] = 1.0 if i == a else 0.0
        solved = solve(matrix, column, size)
        variance = 0.5 * group.noise * column[a] * scale[a] ** 2 if solved else np.inf
        deviation[a // (wide - 1), a % (wide - 1)] = np.sqrt(max(variance, 0.0))
    bounded(work, ZERO, wide, lines, lines)
    for k in range(lines):
        amplitude[k] = work.amplitude[k]
