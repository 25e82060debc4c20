"""Steps of the fit of a group of range bins: lines refined together, and where one more would go.

The equations stand in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import inlined
from trainer.estimators.group_model import bounded, information, least_squares
from trainer.estimators.group_products import (
    COSINE,
    FARTHEST,
    MOST_CELLS,
    SINE,
    VALUE,
    ZERO,
    differentiate,
    evaluate,
    table_place,
)
from trainer.estimators.lines import (
    CLOSEST,
    DAMPING_FACTOR,
    FIRST_DAMPING,
    LARGEST_STEP,
    LEAST_DAMPING,
    MOST_DAMPING,
    RIDGE,
    SETTLED,
)
from trainer.estimators.small_matrices import part, solve

PRUNING_STEPS = np.int64(4)
"""Gauss-Newton steps of a trial."""
ENOUGH = 1e-2
"""Of the noise power: a trial that would gain less is at its optimum."""


@part
def smallest_first(values, count, order):
    """Fill ``order`` with the indices of the ``len(order)`` smallest of ``count`` values; equal ones in their order."""
    kept = 0
    for index in range(count):
        if kept < len(order):
            place = kept
            kept += 1
        elif values[index] < values[order[kept - 1]]:
            place = kept - 1
        else:
            continue
        while place > 0 and values[index] < values[order[place - 1]]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = index
    return kept


@part
def copy(source, lines, out):
    for k in range(lines):
        out[k, 0], out[k, 1] = source[k, 0], source[k, 1]


@part
def put(place, line, u, range_offset):
    place[line, 0], place[line, 1] = u, range_offset


@part
def refine(model, group, place, lines, steps, work):
    """Move the lines [K, 2], in place, to a local optimum; never to a worse one. The energy left with bounded
    amplitudes."""
    if lines == 0:
        return group.energy
    wide, now = 1 + group.coordinates, ZERO
    evaluate(model, group, place, lines, work, now)
    begun = explained = least_squares(work, now, wide, lines)
    best, trial = np.empty((lines, 2)), np.empty((lines, 2))
    copy(place, lines, best)
    damping = FIRST_DAMPING
    step = np.empty(lines * (wide - 1))
    damped = np.empty((lines * (wide - 1), lines * (wide - 1)))
    fresh = True
    for _ in range(steps):
        if fresh:
            differentiate(model, wide, lines, work, now)
            size = information(work, now, wide, lines)
        largest = 0.0
        for a in range(size):
            largest = max(largest, work.curvature[a, a])
        for a in range(size):
            step[a] = work.slope[a]
            for b in range(a, size):
                damped[a, b] = work.curvature[a, b]
            # A line without amplitude has no curvature, and no step.
            damped[a, a] += damping * damped[a, a] + max(RIDGE * largest, 1e-300)
        solved = solve(damped, step, size)
        moved = expected = 0.0
        for a in range(size):
            coordinate = a % (wide - 1)
            unit = model.cell if coordinate == 0 else 1.0
            step[a] = min(max(step[a], -LARGEST_STEP * unit), LARGEST_STEP * unit) if solved else 0.0
            moved = max(moved, abs(step[a]) / unit)
            expected += step[a] * work.slope[a]
        copy(best, lines, trial)
        for a in range(size):
            line, coordinate = a // (wide - 1), a % (wide - 1)
            trial[line, coordinate] += step[a]
            if coordinate > 0:
                trial[line, coordinate] = min(max(trial[line, coordinate], -FARTHEST), FARTHEST)
        evaluate(model, group, trial, lines, work, 1 - now)
        found = least_squares(work, 1 - now, wide, lines)
        fresh = found > explained
        if fresh:
            copy(trial, lines, best)
            explained, now = found, 1 - now
            damping = max(damping / DAMPING_FACTOR, LEAST_DAMPING)
        else:
            damping = min(damping * DAMPING_FACTOR, MOST_DAMPING)
        if moved < SETTLED or expected < ENOUGH * group.noise:
            break
    after = bounded(work, now, wide, lines, lines)
    if after < begun:
        # Bounded amplitudes explain no more than all: only now may the lines have been better where they began.
        evaluate(model, group, place, lines, work, 1 - now)
        before = bounded(work, 1 - now, wide, lines, lines)
        if after < before:
            return max(group.energy - before, 0.0)
    copy(best, lines, place)
    return max(group.energy - after, 0.0)


@inlined(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _at_all_angles(steering, real, imaginary, sign, norm, out_real, out_imaginary):
    """Fill both [A] with sum over channels of steering^(sign) times a value of each, over ``norm``; real and imaginary
    part of steering^* for a sign of -1."""
    for i in range(len(out_real)):
        out_real[i] = out_imaginary[i] = 0.0
    for c in range(len(real)):
        re, im = real[c] / norm, imaginary[c] / norm
        for i in range(len(out_real)):
            out_real[i] += steering[0, c, i] * re - sign * steering[1, c, i] * im
            out_imaginary[i] += steering[0, c, i] * im + sign * steering[1, c, i] * re


@part
def scan(model, group, lines, range_offset, work):
    """What a further line at each search angle meets beside the lines, at one range offset.

    The lines are those of set 0, with amplitudes and factor of least squares. Fills ``work.score`` [A] with the energy
    that it takes, |b^H P x|^2 / b^H P b, ``work.matched`` [2, A] with b^H P x / |b| and ``work.inside`` [K, 2, A] with
    Q^H b / |b|, Q an orthonormal basis of the lines. An angle in their span scores 0. The walk of the echo through the
    bins is left out: it takes a few hundredths of the energy.
    """
    channels, response = len(model.phase), work.response
    inside, score, matched = work.inside, work.score, work.matched
    table, at = model.window, table_place(range_offset)
    row = int(at)
    t = at - row
    weight, norm = np.empty(MOST_CELLS), 0.0
    for m in range(MOST_CELLS):
        weight[m] = table[row, 0, m] + t * (table[row, 1, m] + t * (table[row, 2, m] + t * table[row, 3, m]))
        norm += weight[m] ** 2
    norm = np.sqrt(norm * channels)
    left, own = np.zeros((2, channels)), np.empty((2, channels))
    for m in range(MOST_CELLS):
        for c in range(channels):
            left[0, c] += weight[m] * group.x[0, m, c]
            left[1, c] += weight[m] * group.x[1, m, c]
    for k in range(lines):
        amplitude = work.amplitude[k]
        for c in range(channels):
            value = 0.0
            for m in range(MOST_CELLS):
                value += weight[m] * response[0, k, VALUE + m, c]
            own[0, c], own[1, c] = value * response[0, k, COSINE, c], -value * response[0, k, SINE, c]
            left[0, c] -= own[0, c] * amplitude.real + own[1, c] * amplitude.imag
            left[1, c] -= own[0, c] * amplitude.imag - own[1, c] * amplitude.real
        # A^H b; L^-1 of it is Q^H b.
        _at_all_angles(model.steering, own[0], own[1], 1.0, norm, inside[k, 0], inside[k, 1])
    _at_all_angles(model.steering, left[0], left[1], -1.0, norm, matched[0], matched[1])
    outside = np.ones(len(score))
    for k in range(lines):
        for j in range(k):
            re, im = work.factor[k, j].real, work.factor[k, j].imag
            for i in range(len(score)):
                inside[k, 0, i] -= re * inside[j, 0, i] - im * inside[j, 1, i]
                inside[k, 1, i] -= re * inside[j, 1, i] + im * inside[j, 0, i]
        inverse = work.factor[k, k].real
        for i in range(len(score)):
            inside[k, 0, i] *= inverse
            inside[k, 1, i] *= inverse
            outside[i] -= inside[k, 0, i] ** 2 + inside[k, 1, i] ** 2
    for i in range(len(score)):
        energy = matched[0, i] ** 2 + matched[1, i] ** 2
        score[i] = energy / outside[i] if outside[i] > CLOSEST else 0.0


@part
def highest_peaks(score, order):
    """Fill ``order`` with the highest maxima of the score [A] over angles, which come round; how many."""
    angles = len(score)
    height = np.zeros(angles)
    for index in range(angles):
        if score[index] >= score[(index - 1) % angles] and score[index] > score[(index + 1) % angles]:
            height[index] = -score[index]
    return smallest_first(height, angles, order)


@part
def best_start(model, group, place, lines, work):
    """(angle, range offset, energy) of the best further line; ``work`` holds a scan."""
    if lines:
        evaluate(model, group, place, lines, work, ZERO)
        least_squares(work, ZERO, 1 + group.coordinates, lines)
    angle, offset, most = 0.0, 0.0, -1.0
    farthest = 0 if model.cells == 1 else 1
    for step in range(-farthest, farthest + 1):
        scan(model, group, lines, float(step), work)
        best = np.argmax(work.score)
        if work.score[best] > most:
            angle, offset, most = model.axis[best], float(step), work.score[best]
    return angle, offset, most
