"""The line fit of one group of range bins, compiled.

A group is M range bins (one, or a bin and its neighbours) of one Doppler cell and C channels. A line is an angle u, an
offset r in range from the group's centre [bins] and a complex amplitude s. In bin i of channel c it shows as

    s h(i - r + w_c u) exp(-j k (p_c u + q_c u^2 / R))

with h the window's response (:func:`shared.signal.windows.hann_response`) and w_c = (p_c - mean p) / 2 over the range
step: across the array an echo walks through the range bins, and r is that of the array's middle. R is the group's
range: wave fronts are curved, and the cells have been straightened for u = 0 (:mod:`trainer.estimators.array`). The
noise of neighbouring cells is correlated by the windows; cells and model are multiplied by the inverse of its Cholesky
factor, after which least squares is maximum likelihood.

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
   more than the threshold. Beside more than a few lines of a single bin, and in a group of bins, none is split where an
   added one gains enough. Then step 3 again: an older line may have become needless.
5. In the place of one or two lines the best lone one is tried, of two and more the best pair elsewhere, of three to
   five also pairs beside each one: the lobes of a sparse array make optima that no small step leaves. Where channels
   are few for the lines, one line is tried in the place of each two (:mod:`trainer.estimators.group_replacements`).
6. Where steps 3 to 5 removed or replaced a line of a single bin, they and step 4 begin again.
7. Where too much of a single bin is left still, the fit begins at the angle that takes most by itself, then at the
   next, with as many lines as there may be before the needless ones go: the cheapest stays.

8. Two lines of a group of bins at one angle are one where an echo makes them that migrates through the bins while the
   frame is recorded (:func:`_migrating`).

Steps 6 and 7 find nothing more in a group of bins that is an echo: what its lines leave stands mostly beyond it.
"""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled
from trainer.estimators.group_model import bounded, describe, energy_left, least_squares
from trainer.estimators.group_products import ONE, ZERO, Group, empty_work, evaluate
from trainer.estimators.group_replacements import replaced
from trainer.estimators.group_steps import (
    PRUNING_STEPS,
    best_start,
    copy,
    highest_peaks,
    put,
    refine,
    scan,
    smallest_first,
)
from trainer.estimators.small_matrices import part, part_of_one

STEPS, RACE_STEPS, RACE_KEPT = np.int64(12), np.int64(4), 4
"""Gauss-Newton steps of what is kept, and of a line that is added or split; the best are refined to the end."""
ON_GRID = (0.85, 0.6)
"""Share of its energy that a lone line has at least at the nearest angle that is searched, an eighth of a cell off, in
one bin; and in a group at the nearest whole bin too: half-way between bins that is 0.69."""
ROUNDS = 8
"""In which lines of a single bin are added, removed and replaced, at most: what removes or replaces a line makes room
for others. They end by themselves, as each lowers the cost. With 3 five of 8960 drawn rows of one to eight lines end at
a worse optimum, with 1 eighty: docs/notes/points.md, rows that begin elsewhere."""
STARTS = 8
"""Angles from which a row is fitted again, at most: 136 of those rows end at a better optimum with another number of
lines, with 4 it is 113, and the plain fit's do as well."""
FEW = 6
"""Lines of a single bin, up to which splits are tried where adding one would do. With 3 five of 1280 rows of one to
eight lines have another number than the plain fit finds, with 5 one of 160
(``tests/trainer/estimators/test_fitting.py``). In a group of bins they only cost time: docs/notes/points.md, splits
in groups of bins."""
SPLIT_CELLS = (0.5, 0.2)
"""Distances of the two halves of a split line before they are refined, in resolution cells."""
DRAWS_AT = 1.5
"""Resolution cells: only lines so near to another may lose it for less than least squares at these angles says."""
CHEAPEST = 4
"""Lines whose removal is tried, the others refined again: the cheapest at their places is seldom not among them."""
DEAR = 20.0
"""Times the threshold: a line that costs so much more and has no neighbour is not tried without."""

ONE_ANGLE = 0.1
"""Resolution cells: so near are the lines that an echo's range migration makes two of.
Pairs a quarter of a cell apart, which the channels tell, stay two."""
DISPLACED, WIDENED = 0.2, 0.07
"""Times the migration, and its square: the most of the imaginary part of a migrating echo's mean place, and of its
variance. Those at the edge of a cell of a Hann window are 0.106 and 0.036; where noise just lets a pair pass, at 3.5
deviations, it moves each by a third of itself."""


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
        for ranked in range(smallest_first(costs, lines, order)):
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


@part_of_one
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


@part_of_one
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
        if (model.cells == 1 and lines <= FEW) or not left - energies[0] > model.further * group.noise:
            count += _split(model, group, place, lines, trials[1:], energies[1:], work)
        best, least = -1, left
        for ranked in range(smallest_first(energies, count, order)):
            index = order[ranked]
            energy = energies[0] if count == 1 else refine(model, group, trials[index], lines + 1, STEPS, work)
            if energy < least:
                best, least = index, energy
        if best < 0 or not left - least > model.further * group.noise:
            break
        lines, left, grown = lines + 1, least, True
        copy(trials[best], lines, place)
    return lines, left, grown


@part_of_one
def _begin(model, group, place, lines, work):
    """Of the given lines those that least squares needs, at least one, refined: (lines, left)."""
    costs, fewer = np.empty(model.most), np.empty((model.most, 2))
    order = np.empty(1, dtype=np.int64)
    while lines > 1:
        _cheapest(model, group, place, lines, work, costs)
        smallest_first(costs, lines, order)
        least = order[0]
        if not costs[least] < model.further * group.noise:
            break
        _without(place, lines, least, fewer)
        lines -= 1
        copy(fewer, lines, place)
    return lines, refine(model, group, place, lines, PRUNING_STEPS, work)


@part
def _improve(model, group, place, lines, left, work):
    """Rounds of steps 4, 3 and 5, of a group of bins one: (lines, left)."""
    for _ in range(ROUNDS if model.cells == 1 else 1):
        lines, left, grown = _grow(model, group, place, lines, left, work)
        full, before = lines, left
        if grown:
            lines, left = _prune(model, group, place, lines, left, work)
        lines, left = replaced(model, group, place, lines, left, work)
        if lines == full and left == before:
            break
    return lines, left


@part_of_one
def _begin_elsewhere(model, group, place, lines, left, work):
    """The cheapest of the fits from the highest peaks on, tried while too much is left: (lines, left).

    That is more than the test allows where more than half of the lines that there may be stand, which crowd a row that
    fewer would explain; and of fewer, more by what a line costs.
    """
    price, starts, trial = model.further * group.noise, np.empty(STARTS, dtype=np.int64), np.empty((model.most, 2))
    scan(model, group, ZERO, 0.0, work)
    for ranked in range(highest_peaks(work.score, starts)):
        spare = 0.0 if 2 * lines > model.most else price
        if not left > model.limit[lines] * group.noise + spare:
            break
        put(trial, ZERO, model.axis[starts[ranked]], 0.0)
        count, energy = 1, refine(model, group, trial, ONE, PRUNING_STEPS, work)
        while count < model.most:
            angle, offset, _ = best_start(model, group, trial, count, work)
            put(trial, count, angle, offset)
            count += 1
            energy = refine(model, group, trial, count, PRUNING_STEPS, work)
        count, energy = _prune(model, group, trial, count, energy, work)
        count, energy = _improve(model, group, trial, count, energy, work)
        if energy + count * price < left + lines * price:
            lines, left = count, energy
            copy(trial, lines, place)
    return lines, left


@part_of_one
def _migrating(model, group, place, lines, work):
    """The lines, two at one angle joined where one echo's range migration makes them; how many.

    An echo that migrates by m bins in the frame, d cells from the centre of its Doppler cell, shows in place of h(x) as
    the transform of the range window times H(d + m nu) over the sweep, nu from -1/2 to 1/2, with H the Doppler window's
    response. By log H in powers of m nu that is h, displaced by -j m H' / (2 pi H) and widened as by a distribution of
    the variance -m^2 (log H)'' / (4 pi^2). The fit knows real places alone, and lays two lines at one angle. Mean place
    and variance of these, weighted by their amplitudes, say whether they are such an echo: m is at most
    ``group.migration``, and |d| half a cell. Limit: two echoes at one angle that lie as near are one as well.
    """
    evaluate(model, group, place, lines, work, ZERO)
    least_squares(work, ZERO, 1 + group.coordinates, lines)
    amplitude = work.amplitude
    first = 1
    while first < lines:
        joined = False
        for other in range(first):
            if abs(place[first, 0] - place[other, 0]) > ONE_ANGLE * model.cell:
                continue
            apart, total = place[first, 1] - place[other, 1], amplitude[first] + amplitude[other]
            share = amplitude[first] / total if abs(total) > 0.0 else 0.5 + 0.0j
            spread = abs(share * (1.0 - share)) * apart**2
            if abs(share.imag * apart) < DISPLACED * group.migration and spread < WIDENED * group.migration**2:
                for axis in range(2):
                    place[other, axis] += share.real * (place[first, axis] - place[other, axis])
                amplitude[other] = total
                joined = True
                break
        if not joined:
            first += 1
            continue
        lines -= 1
        amplitude[first] = amplitude[lines]
        put(place, first, place[lines, 0], place[lines, 1])
    return lines


@part_of_one
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
    lines, left = _improve(model, group, place, lines, left, work)
    if model.cells == 1:
        lines, left = _begin_elsewhere(model, group, place, lines, left, work)
    else:
        lines = _migrating(model, group, place, lines, work)
    refine(model, group, place, lines, STEPS, work)
    return lines


@compiled(nogil=True, error_model="numpy")
def fit_in_turn(model, x, scale, given, place, amplitude, deviation):
    """Fit G groups of equal cells.

    :param x: [G, 2, MOST_CELLS, C] see :class:`.group_products.Group`
    :param scale: [G, 3] noise power of one element in the scale of x, 1 / R [1/m], migration [bins]
    :param given: [G, n] angles to begin with, NaN for none
    :param place: [G, most, 2] filled with u and range offsets [bins], NaN where there is no line
    :param amplitude: [G, most], filled; :param deviation: [G, most, 2] of the places, filled
    """
    coordinates = ONE if model.cells == 1 else ONE + ONE
    most = model.most
    for index in range(len(x)):
        energy = 0.0
        for m in range(x.shape[2]):
            for c in range(x.shape[3]):
                energy += x[index, 0, m, c] ** 2 + x[index, 1, m, c] ** 2
        group = Group(x[index], coordinates, scale[index, 0], energy, scale[index, 1], scale[index, 2])
        work = empty_work(most, coordinates, x.shape[3], len(model.axis))
        found = np.zeros((most, 2))
        lines = _fit(model, group, given[index], found, work)
        if lines:
            describe(model, group, found, lines, work, amplitude[index], deviation[index])
            copy(found, lines, place[index])
