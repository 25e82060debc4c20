"""Replacement of a group's lines by others: the best lone one, the best pairs, one line in the place of two.

The procedure that this is a step of stands in :mod:`trainer.estimators.groups`.
"""

from __future__ import annotations

import numpy as np

from trainer.estimators.group_model import least_squares
from trainer.estimators.group_products import ONE, ZERO, evaluate
from trainer.estimators.group_steps import PRUNING_STEPS, copy, highest_peaks, put, refine, scan, smallest_first
from trainer.estimators.lines import KEPT_ANGLES, LEAST_APART, NEAR_CELLS
from trainer.estimators.small_matrices import part_of_one

ELSEWHERE = 3
"""Angles, and pairs of angles far from a row's lines, that are refined in their place."""
MOST_SEARCHED = 5
"""Lines of a group beside each of which pairs are tried."""
CROWDED = 4
"""Channels to a line, of so many or fewer each two lines are tried as one: in one row of a hundred of 12 channels that
ends at a better optimum."""
OFF_GRID = 0.1
"""Share of what lines explain, that they may gain at most by being refined where they stood at grid angles."""


@part_of_one
def _try_lone(model, group, place, lines, left, work):
    """The angles that explain most in place of all: a peak that the fit began with may be a sidelobe's."""
    offset, fewer = place[0, 1], lines - 1
    scan(model, group, ZERO, offset, work)
    trial, peaks = np.empty((1, 2)), np.empty(ELSEWHERE, dtype=np.int64)
    for ranked in range(highest_peaks(work.score, peaks)):
        index = peaks[ranked]
        allowed = left + fewer * model.further * group.noise
        if group.energy - work.score[index] * (1.0 + OFF_GRID) >= allowed:
            break
        put(trial, ZERO, model.axis[index], offset)
        energy = refine(model, group, trial, ONE, PRUNING_STEPS, work)
        if energy < allowed:
            copy(trial, ONE, place)
            lines, left, fewer = 1, energy, 0
    return lines, left


@part_of_one
def _replace_by_pair(model, group, place, lines, left, line, work):
    """The best pairs beside line ``line``, -1 for none, in the place of a group's others where that costs less."""
    kept = 0 if line < 0 else 1
    fewer = lines - kept - 2
    trial = np.empty((kept + 2, 2))
    offset = place[0, 1]
    if kept:
        put(trial, ZERO, place[line, 0], place[line, 1])
        offset = place[0 if line else 1, 1]
        evaluate(model, group, trial, kept, work, ZERO)
        least_squares(work, ZERO, 1 + group.coordinates, kept)
    scan(model, group, kept, offset, work)
    count = min(KEPT_ANGLES, len(model.axis))
    angles = np.empty(count, dtype=np.int64)
    for index in range(len(model.axis)):
        work.score[index] = -work.score[index]
    smallest_first(work.score, len(model.axis), angles)
    # In rising order: the overlap is that of the second angle less the first.
    for i in range(1, count):
        index, j = angles[i], i
        while j > 0 and angles[j - 1] > index:
            angles[j] = angles[j - 1]
            j -= 1
        angles[j] = index
    near = NEAR_CELLS * model.cell
    pairs = count * (count - 1) // 2
    energy, first, second = np.empty(pairs), np.empty(pairs, dtype=np.int64), np.empty(pairs, dtype=np.int64)
    norm, inside, matched = np.ones(count), np.zeros(count, dtype=np.complex128), np.empty(count, dtype=np.complex128)
    power, occupied = np.empty(count), np.zeros(count, dtype=np.bool_)
    for i in range(count):
        if kept:
            inside[i] = complex(work.inside[0, 0, angles[i]], work.inside[0, 1, angles[i]])
            norm[i] = np.sqrt(max(1.0 - inside[i].real ** 2 - inside[i].imag ** 2, LEAST_APART))
        matched[i] = complex(work.matched[0, angles[i]], work.matched[1, angles[i]]) / norm[i]
        power[i] = matched[i].real ** 2 + matched[i].imag ** 2
        # Where a line fewer would do, the best pair may stand near the lines.
        if lines == 2:
            for k in range(2):
                occupied[i] |= abs(model.axis[angles[i]] - place[k, 0]) < near
    pair = 0
    for i in range(count):
        for j in range(i + 1, count):
            first[pair], second[pair], energy[pair] = i, j, 0.0
            if not (occupied[i] and occupied[j]):
                overlap = model.overlap[angles[j] - angles[i]] - np.conj(inside[i]) * inside[j]
                overlap = overlap / (norm[i] * norm[j])
                apart = 1.0 - overlap.real**2 - overlap.imag**2
                if apart > LEAST_APART:
                    cross = np.conj(matched[i]) * matched[j]
                    joint = power[i] + power[j] - 2.0 * (cross.real * overlap.real - cross.imag * overlap.imag)
                    energy[pair] = joint / apart
            pair += 1
    have = group.energy
    if kept:
        # What the kept line leaves by itself.
        have = group.energy - (work.right[0, 0].real ** 2 + work.right[0, 0].imag ** 2) / work.gram[0, 0, 0].real
    best_left, best = np.inf, np.empty((kept + 2, 2))
    allowed = left + fewer * model.further * group.noise
    for _ in range(ELSEWHERE):
        top = np.argmax(energy)
        if have - energy[top] - OFF_GRID * (group.energy - have + energy[top]) >= allowed:
            break
        low, high = model.axis[angles[first[top]]], model.axis[angles[second[top]]]
        put(trial, kept, low, offset)
        put(trial, kept + 1, high, offset)
        if kept:
            put(trial, ZERO, place[line, 0], place[line, 1])
        found = refine(model, group, trial, kept + 2, PRUNING_STEPS, work)
        if found < best_left:
            best_left = found
            copy(trial, kept + 2, best)
        for pair in range(pairs):
            a, b = model.axis[angles[first[pair]]], model.axis[angles[second[pair]]]
            if min(abs(a - low), abs(a - high)) < near and min(abs(b - low), abs(b - high)) < near:
                energy[pair] = 0.0
    if best_left < allowed:
        lines, left = kept + 2, best_left
        copy(best, lines, place)
    return lines, left


@part_of_one
def _merge(model, group, place, lines, left, work):
    """The best line in the place of two, for each two of a group's, where that costs less: (lines, left)."""
    kept, best = lines - 2, lines
    trial, found = np.empty((lines - 1, 2)), np.empty((lines - 1, 2))
    least = left + model.further * group.noise
    for first in range(lines):
        for second in range(first):
            count = 0
            for line in range(lines):
                if line not in (first, second):
                    put(trial, count, place[line, 0], place[line, 1])
                    count += 1
            evaluate(model, group, trial, kept, work, ZERO)
            explained = least_squares(work, ZERO, 1 + group.coordinates, kept)
            # One scan, half-way between the two: one for each bin costs more and ends no better.
            offset = 0.5 * (place[first, 1] + place[second, 1])
            scan(model, group, kept, offset, work)
            at = np.argmax(work.score)
            angle, most = model.axis[at], work.score[at]
            if group.energy - explained - most - OFF_GRID * (explained + most) < least:
                put(trial, kept, angle, offset)
                energy = refine(model, group, trial, lines - 1, PRUNING_STEPS, work)
                if energy < least:
                    least, best = energy, lines - 1
                    copy(trial, best, found)
    if best < lines:
        copy(found, best, place)
        return best, least
    return lines, left


@part_of_one
def replaced(model, group, place, lines, left, work):
    """Others in the place of a group's lines where they cost less, step 5 of the fit: (lines, left)."""
    if 0 < lines <= 2:
        lines, left = _try_lone(model, group, place, lines, left, work)
    if lines >= 2:
        count = lines
        for line in range(-1, count if 2 < count <= MOST_SEARCHED else 0):
            if lines == count:
                lines, left = _replace_by_pair(model, group, place, lines, left, line, work)
    if lines > 2 and CROWDED * lines >= len(model.phase):
        lines, left = _merge(model, group, place, lines, left, work)
    return lines, left
