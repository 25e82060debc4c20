"""Steps of the fit of a group of range bins: lines refined together, and where one more would go.

The equations stand in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

import numpy as np

from trainer.estimators.group_model import (
    FARTHEST,
    RIDGE,
    ZERO,
    bounded,
    evaluate,
    every,
    information,
    least_squares,
    window,
)
from trainer.estimators.small_matrices import dot, forward, part, solve

LARGEST_STEP, SETTLED = 0.25, 1e-6
"""Of a resolution cell or a bin: farther than the one the linear step is no guide, below the other it changes
nothing."""
ENOUGH = 1e-2
"""Of the noise power: a trial that would gain less is at its optimum."""
FIRST_DAMPING, DAMPING_FACTOR, LEAST_DAMPING, MOST_DAMPING = 1e-3, 10.0, 1e-9, 1e9
"""Levenberg's, relative to the diagonal: a rejected step raises it, an accepted one lowers it."""
CLOSEST = 1e-9
"""Least share of a line outside the span of others that is told from rounding."""


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
    everyone = every(lines)
    evaluate(model, group, place, lines, work, now)
    before = bounded(work.gram[now], work.right[now], wide, everyone, lines, work.amplitude, work.factor)
    explained = least_squares(work.gram[now], work.right[now], wide, lines, work.factor, work.amplitude)
    best, trial = np.empty((lines, 2)), np.empty((lines, 2))
    keep = np.empty(lines, dtype=np.complex128)
    copy(place, lines, best)
    damping = FIRST_DAMPING
    step = np.empty(lines * (wide - 1))
    damped = np.empty((lines * (wide - 1), lines * (wide - 1)))
    fresh = True
    for _ in range(steps):
        if fresh:
            size = information(work.gram[now], work.right[now], wide, lines, work)
        largest = 0.0
        for a in range(size):
            largest = max(largest, work.curvature[a, a])
        for a in range(size):
            step[a] = work.slope[a]
            for b in range(size):
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
        for k in range(lines):
            keep[k] = work.amplitude[k]
        found = least_squares(work.gram[1 - now], work.right[1 - now], wide, lines, work.factor, work.amplitude)
        fresh = found > explained
        if fresh:
            copy(trial, lines, best)
            explained, now = found, 1 - now
            damping = max(damping / DAMPING_FACTOR, LEAST_DAMPING)
        else:
            for k in range(lines):
                work.amplitude[k] = keep[k]
            damping = min(damping * DAMPING_FACTOR, MOST_DAMPING)
        if moved < SETTLED or expected < ENOUGH * group.noise:
            break
    after = bounded(work.gram[now], work.right[now], wide, everyone, lines, work.amplitude, work.factor)
    if after >= before:
        copy(best, lines, place)
        return max(group.energy - after, 0.0)
    return max(group.energy - before, 0.0)


@part
def scan(model, group, place, lines, range_offset, work):
    """What a further line at each search angle meets beside the lines, at one range offset.

    Fills ``work.score`` [A] with the energy that it takes, |b^H P x|^2 / b^H P b, ``work.matched`` [A] with b^H P x /
    |b| and ``work.inside`` [K, A] with Q^H b / |b|, Q an orthonormal basis of the lines. An angle in their span scores
    0. The walk of the echo through the bins is left out: it takes a few hundredths of the energy.
    """
    channels, cells = len(model.phase), len(group.white)
    wide = 1 + group.coordinates
    weight = np.empty(cells)
    norm = 0.0
    for m in range(cells):
        weight[m] = 0.0
        for other in range(m + 1):
            value = window(model.response, group.offset[other] - range_offset)[0]
            weight[m] += group.white[m, other] * (value if cells > 1 else 1.0)
        norm += weight[m] ** 2
    norm = np.sqrt(norm * channels)
    reduced = np.zeros((2, lines + 1, channels))
    factor, amplitude = work.factor, work.amplitude
    if lines:
        evaluate(model, group, place, lines, work, ZERO)
        least_squares(work.gram[0], work.right[0], wide, lines, factor, amplitude)
    for m in range(cells):
        for c in range(channels):
            n = m * channels + c
            real, imaginary = group.x[0, n], group.x[1, n]
            for k in range(lines):
                a, b = work.re[0, k * wide, n], work.im[0, k * wide, n]
                real -= a * amplitude[k].real - b * amplitude[k].imag
                imaginary -= a * amplitude[k].imag + b * amplitude[k].real
                reduced[0, k, c] += weight[m] * a
                reduced[1, k, c] += weight[m] * b
            reduced[0, lines, c] += weight[m] * real
            reduced[1, lines, c] += weight[m] * imaginary
    span = np.empty(lines, dtype=np.complex128)
    for i in range(len(model.axis)):
        real, imaginary = dot(model.steering[0, i], model.steering[1, i], reduced[0, lines], reduced[1, lines])
        work.matched[i] = complex(real, imaginary) / norm
        outside = 1.0
        for k in range(lines):
            # A^H b; L^-1 of it is Q^H b.
            real, imaginary = dot(reduced[0, k], reduced[1, k], model.steering[0, i], model.steering[1, i])
            span[k] = complex(real, imaginary) / norm
        forward(factor, lines, span)
        for k in range(lines):
            work.inside[k, i] = span[k]
            outside -= span[k].real ** 2 + span[k].imag ** 2
        energy = work.matched[i].real ** 2 + work.matched[i].imag ** 2
        work.score[i] = energy / outside if outside > CLOSEST else 0.0


@part
def best_start(model, group, place, lines, work):
    """(angle, range offset, energy) of the best further line; ``work`` holds the scan at that offset."""
    if len(group.white) == 1:
        scan(model, group, place, lines, 0.0, work)
        best = np.argmax(work.score)
        return model.axis[best], 0.0, work.score[best]
    angle, offset, most = 0.0, 0.0, -1.0
    for step in range(-1, 2):
        scan(model, group, place, lines, float(step), work)
        best = np.argmax(work.score)
        if work.score[best] > most:
            angle, offset, most = model.axis[best], float(step), work.score[best]
    return angle, offset, most
