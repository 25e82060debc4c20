"""A group of range-Doppler cells and its model: responses of lines, least squares, what is left, how well it is told.

The equations stand in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.small_matrices import backward, cholesky, dot, eigen, forward, part, solve

SEPARABLE = 0.05
"""Least eigenvalue of the Gram matrix of normed lines whose part of the amplitudes is told, see
:func:`trainer.estimators.lines.bounded_amplitudes`."""
RIDGE = 1e-12
"""On the diagonal of a Gram matrix: two lines at one place share its amplitude instead of failing."""
FARTHEST = 2.5
"""Bins from a group's centre to a line that it is told of: what stands there reaches its outer cells."""
POINTS_A_BIN = 64
"""Of the table of a window's response, read by cubic Hermite interpolation: 1e-8 of the peak."""


ZERO, ONE = np.int64(0), np.int64(1)
"""Of one type wherever they are passed on: see :data:`.small_matrices.part`."""


class Model(NamedTuple):
    """What all groups share; A search angles."""

    phase: NDArray[np.float64]
    """[C] k p_c [rad]"""
    walk: NDArray[np.float64]
    """[C] w_c [bins]"""
    curve: NDArray[np.float64]
    """[C] k q_c [rad m]"""
    response: NDArray[np.float64]
    """[2, S] h and its derivative from 0 on, at POINTS_A_BIN"""
    cell: float
    """Resolution cell in u"""
    axis: NDArray[np.float64]
    """[A] uniform"""
    steering: NDArray[np.float64]
    """[2, A, C] real and imaginary part of exp(-j k p u)"""
    overlap: NDArray[np.complex128]
    """[A] mean over channels of exp(-j k p u) at multiples of the axis' step"""
    first: float
    """Threshold of the first line of a group"""
    further: float
    """Threshold of every other line"""
    limit: NDArray[np.float64]
    """[M + 1, most + 1] energy in units of the noise below which nothing is added, by cells and lines"""
    most: int
    """Lines of a group"""


class Work(NamedTuple):
    """Scratch of one group: V = lines (1 + coordinates) columns, two sets of them."""

    re: NDArray[np.float64]
    im: NDArray[np.float64]
    gram: NDArray[np.complex128]
    right: NDArray[np.complex128]
    amplitude: NDArray[np.complex128]
    factor: NDArray[np.complex128]
    mixed: NDArray[np.complex128]
    curvature: NDArray[np.float64]
    slope: NDArray[np.float64]
    score: NDArray[np.float64]
    matched: NDArray[np.complex128]
    inside: NDArray[np.complex128]


class Group(NamedTuple):
    """The data of one group."""

    x: NDArray[np.float64]
    """[2, N] real and imaginary part, whitened, of largest element about 1"""
    offset: NDArray[np.int64]
    """[M] range bins from the centre"""
    white: NDArray[np.float64]
    """[M, M] inverse Cholesky factor of the cells' noise"""
    coordinates: int | np.int64
    """Of a line, that the cells tell: 1, its u, or 2, its range as well"""
    noise: float
    """Power of one element"""
    energy: float
    """|x|^2"""
    bend: float
    """1 / R [1/m]"""


@part
def window(response, x):
    """(h, dh/dx) of the window at x [cells]; 0 beyond the table."""
    place = abs(x) * POINTS_A_BIN
    below = int(place)
    if below + 1 >= response.shape[1]:
        return 0.0, 0.0
    t, step = place - below, 1.0 / POINTS_A_BIN
    low, high = response[0, below], response[0, below + 1]
    rise, next_rise = response[1, below] * step, response[1, below + 1] * step
    bend = 3.0 * (high - low) - 2.0 * rise - next_rise
    twist = 2.0 * (low - high) + rise + next_rise
    value = low + t * (rise + t * (bend + t * twist))
    slope = (rise + t * (2.0 * bend + 3.0 * t * twist)) * POINTS_A_BIN
    return value, slope if x >= 0.0 else -slope


@part
def columns_of(model, group, place, lines, re, im):
    """Fill re and im [V, N] with the responses of ``lines`` lines at ``place`` [K, 2] and their derivatives."""
    channels, cells = len(model.phase), len(group.white)
    wide = 1 + group.coordinates
    plain = np.empty((2, cells))
    for k in range(lines):
        u = place[k, 0]
        for c in range(channels):
            bent = model.curve[c] * group.bend * u
            angle, turn = (model.phase[c] + bent) * u, model.phase[c] + 2.0 * bent
            cosine, sine = np.cos(angle), -np.sin(angle)
            if cells == 1 and wide == 2:
                re[k * wide, c], im[k * wide, c] = cosine, sine
                re[k * wide + 1, c], im[k * wide + 1, c] = turn * sine, -turn * cosine
                continue
            for m in range(cells):
                plain[0, m], plain[1, m] = window(model.response, group.offset[m] - place[k, 1] + model.walk[c] * u)
            for m in range(cells):
                value = by_range = 0.0
                for other in range(m + 1):
                    weight = group.white[m, other]
                    value += weight * plain[0, other]
                    by_range += weight * plain[1, other]
                n = m * channels + c
                re[k * wide, n], im[k * wide, n] = value * cosine, value * sine
                by_angle, by_place = k * wide + 1, k * wide + 2
                turned, walked = turn * value, model.walk[c] * by_range
                re[by_angle, n] = turned * sine + walked * cosine
                im[by_angle, n] = walked * sine - turned * cosine
                if wide == 3:
                    re[by_place, n], im[by_place, n] = -by_range * cosine, -by_range * sine


@part
def products(group, columns, re, im, gram, right):
    """The inner products of all columns with each other and with x."""
    for a in range(columns):
        real, imaginary = dot(re[a], im[a], group.x[0], group.x[1])
        right[a] = complex(real, imaginary)
        for b in range(a + 1):
            real, imaginary = dot(re[a], im[a], re[b], im[b])
            gram[a, b], gram[b, a] = complex(real, imaginary), complex(real, -imaginary)


@part
def _solved(factor, lines, amplitude):
    """The energy that lines explain whose Gram matrix stands in ``factor``, and A^H x in ``amplitude``; leaves the
    Cholesky factor and the amplitudes there."""
    cholesky(factor, lines)
    forward(factor, lines, amplitude)
    explained = 0.0
    for i in range(lines):
        explained += amplitude[i].real ** 2 + amplitude[i].imag ** 2
    backward(factor, lines, amplitude)
    return explained


@part
def least_squares(gram, right, wide, lines, factor, amplitude):
    """Amplitudes of the lines and the energy that they explain; leaves the Cholesky factor of their Gram matrix."""
    for i in range(lines):
        for j in range(i + 1):
            factor[i, j] = gram[i * wide, j * wide]
        factor[i, i] = factor[i, i] * (1.0 + RIDGE) + RIDGE
        amplitude[i] = right[i * wide]
    return _solved(factor, lines, amplitude)


@part
def bounded(gram, right, wide, used, lines, amplitude, factor):
    """Amplitudes without the directions that noise decides, and the energy that they explain.

    :param used: [K] which of the columns' lines take part, ``lines`` of them
    """
    # Where all eigenvalues of the normed Gram matrix are above SEPARABLE nothing is left out.
    for i in range(lines):
        own = gram[used[i] * wide, used[i] * wide].real
        for j in range(i + 1):
            other = gram[used[j] * wide, used[j] * wide].real
            factor[i, j] = gram[used[i] * wide, used[j] * wide] / np.sqrt(max(own * other, 1e-300))
        factor[i, i] = 1.0 - SEPARABLE
    if cholesky(factor, lines):
        for i in range(lines):
            for j in range(i + 1):
                factor[i, j] = gram[used[i] * wide, used[j] * wide]
            amplitude[i] = right[used[i] * wide]
        return _solved(factor, lines, amplitude)
    normed = np.empty((lines, lines), dtype=np.complex128)
    norm = np.empty(lines)
    for i in range(lines):
        norm[i] = np.sqrt(max(gram[used[i] * wide, used[i] * wide].real, 1e-300))
    for i in range(lines):
        for j in range(lines):
            normed[i, j] = gram[used[i] * wide, used[j] * wide] / (norm[i] * norm[j])
        normed[i, i] = 1.0
        amplitude[i] = 0.0
    vectors = np.empty((lines, lines), dtype=np.complex128)
    eigen(normed, vectors, lines)
    explained = 0.0
    for j in range(lines):
        if normed[j, j].real >= SEPARABLE:
            along = 0.0j
            for i in range(lines):
                along += np.conj(vectors[i, j]) * right[used[i] * wide] / norm[i]
            explained += (along.real**2 + along.imag**2) / normed[j, j].real
            for i in range(lines):
                amplitude[i] += vectors[i, j] * along / normed[j, j].real / norm[i]
    return explained


@part
def every(lines):
    """[lines] which lines take part: all of them."""
    return np.arange(lines)


@part
def information(gram, right, wide, lines, work):
    """Curvature Re[J^H J] and slope Re[J^H x] of all free coordinates, from the factor and amplitudes in ``work``."""
    factor, amplitude, mixed = work.factor, work.amplitude, work.mixed
    size = lines * (wide - 1)
    for a in range(size):
        line, column = a // (wide - 1), a // (wide - 1) * wide + 1 + a % (wide - 1)
        # (L^-1 A^H D)_a; what is left of x is orthogonal to A.
        for k in range(lines):
            mixed[a, k] = gram[k * wide, column]
        forward(factor, lines, mixed[a])
        residual = right[column]
        for k in range(lines):
            residual -= gram[column, k * wide] * amplitude[k]
        work.slope[a] = (np.conj(amplitude[line]) * residual).real
        for b in range(a + 1):
            other, beside = b // (wide - 1), b // (wide - 1) * wide + 1 + b % (wide - 1)
            value = gram[column, beside]
            for k in range(lines):
                value -= np.conj(mixed[a, k]) * mixed[b, k]
            value *= np.conj(amplitude[line]) * amplitude[other]
            work.curvature[a, b] = work.curvature[b, a] = value.real
    return size


@part
def evaluate(model, group, place, lines, work, which):
    """Fill set ``which`` of ``work`` for lines at ``place``."""
    wide = 1 + group.coordinates
    columns_of(model, group, place, lines, work.re[which], work.im[which])
    products(group, lines * wide, work.re[which], work.im[which], work.gram[which], work.right[which])


@part
def energy_left(model, group, place, lines, work):
    """Energy that lines at ``place`` leave with bounded amplitudes; set 0 of ``work`` is theirs."""
    evaluate(model, group, place, lines, work, ZERO)
    wide = 1 + group.coordinates
    explained = bounded(work.gram[0], work.right[0], wide, every(lines), lines, work.amplitude, work.factor)
    return max(group.energy - explained, 0.0)


@part
def describe(model, group, place, lines, work, amplitude, deviation):
    """Bounded amplitudes [K] and Cramer-Rao deviations [K, 2] of the lines."""
    wide = 1 + group.coordinates
    evaluate(model, group, place, lines, work, ZERO)
    least_squares(work.gram[0], work.right[0], wide, lines, work.factor, work.amplitude)
    size = information(work.gram[0], work.right[0], wide, lines, work)
    scale, matrix, column = np.empty(size), np.empty((size, size)), np.empty(size)
    for a in range(size):
        # Elements at one place say nothing of an angle, but for rounding.
        scale[a] = 1.0 / np.sqrt(max(work.curvature[a, a], RIDGE * (2.0 * np.pi) ** 2 * group.energy))
    for a in range(size):
        for i in range(size):
            for j in range(size):
                matrix[i, j] = work.curvature[i, j] * scale[i] * scale[j]
            matrix[i, i] += RIDGE
            column[i] = 1.0 if i == a else 0.0
        solved = solve(matrix, column, size)
        variance = 0.5 * group.noise * column[a] * scale[a] ** 2 if solved else np.inf
        deviation[a // (wide - 1), a % (wide - 1)] = np.sqrt(max(variance, 0.0))
    bounded(work.gram[0], work.right[0], wide, every(lines), lines, work.amplitude, work.factor)
    for k in range(lines):
        amplitude[k] = work.amplitude[k]
