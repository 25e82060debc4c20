"""The line fit of one group of range bins, compiled; groups are shared out to threads.

A group is M range bins (one, or a bin and its neighbours) of one Doppler cell and C channels. A line is an angle u, an
offset r in range from the group's centre [bins] and a complex amplitude s. In bin i of channel c it shows as

    s h(i - r + w_c u) exp(-j k (p_c u + q_c u^2 / R))

with h the window's response (:func:`trainer.estimators.fitting.hann_response`) and w_c = p_c / 2 over the range step:
across the array an echo walks through the range bins. R is the group's range: wave fronts are curved, and the cells
have been straightened for u = 0 (:mod:`trainer.estimators.array`). The noise of neighbouring cells is correlated by the
windows; cells and model are multiplied by the inverse of its Cholesky factor, after which least squares is maximum
likelihood.

With A [N, K] the responses of K lines to unit amplitudes, N = M C, and D their derivatives by the free coordinates, the
amplitudes are s = A^+ x, P = I - A A^+ projects on what they leave, and the step of least squares in all coordinates is

    Re[(P D diag(s))^H (P D diag(s))]^-1 Re[(P D diag(s))^H x]

(Golub and Pereyra 1973 in the form of Kaufman 1975), damped as Levenberg does. All of it follows from the inner
products of the columns of A and D with each other and with x, which is what the time goes to.

A line stays where it lowers what is left by more than a threshold times the noise (a generalised likelihood-ratio test
with known noise):

1. A group in which no line takes more than the first threshold has none, and costs nothing more.
2. The given angles that least squares needs are refined together.
3. The line whose removal, the others refined again, costs least is removed while it costs less than the threshold.
4. Where the energy left fails its chi-square test a line is added or one is split; the best is kept while it gains
   more than the threshold. Beside more than a few lines none is split where an added one gains enough. Then step 3
   again: an older line may have become needless.
5. In the place of one or two lines the best lone one is tried, of two and more the best pair elsewhere, of three to
   five also pairs beside each one: the lobes of a sparse array make optima that no small step leaves. Where channels
   are few for the lines, one line is tried in the place of each two.
6. Where steps 3 to 5 removed or replaced a line, they and step 4 begin again.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from shared.physics.compiled import compiled
from trainer.estimators.group_model import bounded, describe, energy_left, least_squares
from trainer.estimators.group_products import ONE, ZERO, Group, empty_work, evaluate
from trainer.estimators.group_steps import best_start, copy, put, refine, scan
from trainer.estimators.small_matrices import part

STEPS, PRUNING_STEPS, RACE_STEPS, RACE_KEPT = np.int64(12), np.int64(4), np.int64(4), 4
"""Gauss-Newton steps of what is kept, of a trial, and of a line that is added or split; of splits the best are refined
to the end."""
ON_GRID = (0.85, 0.6)
"""Share of its energy that a lone line has at least at the nearest angle that is searched, an eighth of a cell off, in
one bin; and in a group at the nearest whole bin too: half-way between bins that is 0.69."""
ROUNDS = 8
"""In which lines are added, removed and replaced, at most: what removes or replaces a line makes room for others. They
end by themselves, as each lowers the cost. With 3 four of 1280 rows have another number than the plain fit finds, with
8 three (``tests/trainer/estimators/test_fitting.py``)."""
FEW = 6
"""Lines, up to which splits are tried where adding one would do. With 3 five of 1280 rows of one to eight lines have
another number than the plain fit finds, with 5 one of 160 (``tests/trainer/estimators/test_fitting.py``)."""
SPLIT_CELLS = (0.5, 0.2)
"""Distances of the two halves of a split line before they are refined, in resolution cells."""
ELSEWHERE = 3
"""Angles, and pairs of angles far from a row's lines, that are refined in their place."""
MOST_SEARCHED = 5
"""Lines of a group beside each of which pairs are tried."""
CROWDED = 4
"""Channels to a line, of so many or fewer each two lines are tried as one: in one row of a hundred of 12 channels that
ends at a better optimum."""
NEAR_CELLS = 0.2
"""Angles so near are refined to the same ones."""
KEPT_ANGLES = 48
"""Of a group, of which all pairs are tried."""
DRAWS_AT = 1.5
"""Resolution cells: only lines so near to another may lose it for less than least squares at these angles says."""
CHEAPEST = 4
"""Lines whose removal is tried, the others refined again: the cheapest at their places is seldom not among them."""
DEAR = 20.0
"""Times the threshold: a line that costs so much more and has no neighbour is not tried without."""
LEAST_APART = 1e-4
"""Least share of a pair's lines outside each other that is told from rounding."""
OFF_GRID = 0.1
"""Share of its energy that a pair between grid angles may gain by being refined, at most."""


@part
def _smallest_first(values, count, order):
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
def _without(place, lines, line, out):
    """Copy all lines but one."""
    for k in range(lines - 1):
        other = k if k < line else k + 1
        out[k, 0], out[k, 1] = place[other, 0], place[other, 1]


@part
def _cheapest(model, group, place, lines, work, costs):
    """Fill ``costs`` [K] with the energy that each line's removal adds at these places; energy left with all."""
    left = energy_left(model, group, place, lines, work)
    for line in range(lines):
        explained = bounded(work, ZERO, 1 + group.coordinates, lines - 1, line)
        costs[line] = group.energy - explained - left
    return left


@part
def _prune(model, group, place, lines, left, work):
    """Remove lines, the others refined again, while the cheapest one gains less than its threshold: (lines, left)."""
    costs, trial, best = np.empty(model.most), np.empty((model.most, 2)), np.empty((model.most, 2))
    order = np.empty(CHEAPEST, dtype=np.int64)
    while lines:
        price = (model.first if lines == 1 else model.further) * group.noise
        if lines == 1:
            if group.energy - left >= price:
                break
            return 0, group.energy
        _cheapest(model, group, place, lines, work, costs)
        least = np.inf
        for ranked in range(_smallest_first(costs, lines, order)):
            line = order[ranked]
            near = False
            for other in range(lines):
                near |= other != line and abs(place[other, 0] - place[line, 0]) < DRAWS_AT * model.cell
            if costs[line] > DEAR * price and not near:
                continue
            _without(place, lines, line, trial)
            energy = refine(model, group, trial, lines - 1, PRUNING_STEPS, work)
            if energy < least:
                least = energy
                copy(trial, lines - 1, best)
            if costs[line] < price:
                break
        if not least - left < price:
            break
        lines, left = lines - 1, least
        copy(best, lines, place)
    return lines, left


@part
def _split(model, group, place, lines, trials, energies, work):
    """Fill ``trials`` with the lines of which one is split, and ``energies`` with what a few steps leave; how many."""
    count = 0
    for line in range(lines):
        for apart in SPLIT_CELLS:
            copy(place, lines, trials[count])
            put(trials[count], lines, place[line, 0], place[line, 1])
            trials[count, line, 0] -= 0.5 * apart * model.cell
            trials[count, lines, 0] += 0.5 * apart * model.cell
            energies[count] = refine(model, group, trials[count], lines + 1, RACE_STEPS, work)
            count += 1
    return count


@part
def _grow(model, group, place, lines, left, work):
    """Add or split lines while the energy left fails its test and the best trial gains: (lines, left, grown)."""
    grown = False
    trials, energies = np.empty((2 * model.most + 1, model.most, 2)), np.empty(2 * model.most + 1)
    order = np.empty(RACE_KEPT, dtype=np.int64)
    while 0 < lines < model.most and left > model.limit[lines] * group.noise:
        angle, offset, _ = best_start(model, group, place, lines, work)
        copy(place, lines, trials[0])
        put(trials[0], lines, angle, offset)
        energies[0] = refine(model, group, trials[0], lines + 1, RACE_STEPS, work)
        count = 1
        if lines <= FEW or not left - energies[0] > model.further * group.noise:
            count += _split(model, group, place, lines, trials[1:], energies[1:], work)
        best, least = -1, left
        for ranked in range(_smallest_first(energies, count, order)):
            index = order[ranked]
            energy = energies[0] if count == 1 else refine(model, group, trials[index], lines + 1, STEPS, work)
            if energy < least:
                best, least = index, energy
        if best < 0 or not left - least > model.further * group.noise:
            break
        lines, left, grown = lines + 1, least, True
        copy(trials[best], lines, place)
    return lines, left, grown


@part
def _try_lone(model, group, place, lines, left, work):
    """The angles that explain most in place of all: a peak that the fit began with may be a sidelobe's."""
    offset, fewer = place[0, 1], lines - 1
    scan(model, group, ZERO, offset, work)
    angles = len(model.axis)
    trial, height = np.empty((1, 2)), np.empty(angles)
    peaks = np.empty(ELSEWHERE, dtype=np.int64)
    for index in range(angles):
        before, after = work.score[(index - 1) % angles], work.score[(index + 1) % angles]
        height[index] = -work.score[index] if work.score[index] >= before and work.score[index] > after else 0.0
    count = _smallest_first(height, angles, peaks)
    for ranked in range(count):
        index = peaks[ranked]
        allowed = left + fewer * model.further * group.noise
        if group.energy + height[index] * (1.0 + OFF_GRID) >= allowed:
            break
        put(trial, ZERO, model.axis[index], offset)
        energy = refine(model, group, trial, ONE, PRUNING_STEPS, work)
        if energy < allowed:
            copy(trial, ONE, place)
            lines, left, fewer = 1, energy, 0
    return lines, left


@part
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
    _smallest_first(work.score, len(model.axis), angles)
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


@part
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
            angle, offset, most = best_start(model, group, trial, kept, work)
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


@part
def _begin(model, group, place, lines, work):
    """Of the given lines those that least squares needs, at least one, refined: (lines, left)."""
    costs, fewer = np.empty(model.most), np.empty((model.most, 2))
    order = np.empty(1, dtype=np.int64)
    while lines > 1:
        _cheapest(model, group, place, lines, work, costs)
        _smallest_first(costs, lines, order)
        least = order[0]
        if not costs[least] < model.further * group.noise:
            break
        _without(place, lines, least, fewer)
        lines -= 1
        copy(fewer, lines, place)
    return lines, refine(model, group, place, lines, PRUNING_STEPS, work)


@part
def _fit(model, group, given, place, work):
    """Fit one group from the angles ``given`` on; the number of lines, at ``place`` [most, 2]."""
    angle, offset, most = best_start(model, group, place, ZERO, work)
    least = model.first * group.noise
    if not most > least:
        if not most > ON_GRID[0 if model.cells == 1 else 1] * least:
            return 0
        put(place, ZERO, angle, offset)
        if not group.energy - refine(model, group, place, ONE, PRUNING_STEPS, work) > least:
            return 0
    lines = 0
    for index in range(len(given)):
        start = given[index]
        if not np.isnan(start) and lines < model.most:
            put(place, lines, start, offset)
            lines += 1
    if lines == 0:
        put(place, ZERO, angle, offset)
        lines = 1
    lines, left = _begin(model, group, place, lines, work)
    lines, left = _prune(model, group, place, lines, left, work)
    if lines == 0:
        # The given angles led to a lesser lobe.
        put(place, ZERO, angle, offset)
        lines = 1
    left = refine(model, group, place, lines, STEPS, work)
    for _ in range(ROUNDS):
        lines, left, grown = _grow(model, group, place, lines, left, work)
        full, before = lines, left
        if grown:
            lines, left = _prune(model, group, place, lines, left, work)
        if 0 < lines <= 2:
            lines, left = _try_lone(model, group, place, lines, left, work)
        if lines >= 2:
            count = lines
            lines, left = _replace_by_pair(model, group, place, lines, left, -ONE, work)
            for line in range(count if 2 < count <= MOST_SEARCHED else 0):
                if lines == count:
                    lines, left = _replace_by_pair(model, group, place, lines, left, line, work)
        if lines > 2 and CROWDED * lines >= len(model.phase):
            lines, left = _merge(model, group, place, lines, left, work)
        if lines == full and left == before:
            break
    refine(model, group, place, lines, STEPS, work)
    return lines


@compiled(parallel=True, error_model="numpy")
def fit_all(model, x, scale, given, place, amplitude, deviation):
    """Fit G groups of equal cells.

    :param x: [G, 2, MOST_CELLS, C] see :class:`.group_products.Group`
    :param scale: [G, 2] noise power of one element in the scale of x, 1 / R [1/m]
    :param given: [G, n] angles to begin with, NaN for none
    :param place: [G, most, 2] filled with u and range offsets [bins], NaN where there is no line
    :param amplitude: [G, most], filled; :param deviation: [G, most, 2] of the places, filled
    """
    coordinates = ONE if model.cells == 1 else ONE + ONE
    most = model.most
    for index in prange(len(x)):
        energy = 0.0
        for m in range(x.shape[2]):
            for c in range(x.shape[3]):
                energy += x[index, 0, m, c] ** 2 + x[index, 1, m, c] ** 2
        group = Group(x[index], coordinates, scale[index, 0], energy, scale[index, 1])
        work = empty_work(most, coordinates, x.shape[3], len(model.axis))
        found = np.zeros((most, 2))
        lines = _fit(model, group, given[index], found, work)
        if lines:
            describe(model, group, found, lines, work, amplitude[index], deviation[index])
            copy(found, lines, place[index])
