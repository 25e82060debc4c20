"""Fewer paths of the same power: at most so many in a cell of range, u and range rate.

Rays are cheap and paths are dear: what a frame costs is the paths that are synthesised. Near the sensor a resolution
cell has hundreds of rays, far away it has one. A cell with more than K paths keeps K of them. Paths that hold 1/K of
the cell's power or more stay as they are. Of the others, of power P together, as many as are left of K are drawn, k of
them, with probabilities k p_i / P (systematic sampling, Madow 1949), and each that is drawn has the power P / k.

The cell's power is therefore what all its rays say, exactly, and that of any part of the cell is so on average. K
random phases of equal power make speckle whose intensity has the variance 1 - 1/K of fully developed speckle (Goodman,
Speckle Phenomena in Optics, section 3.6).

Pruning: the weakest scattered paths of each range bin are left out.

The paths left out hold together at most a given share of their bin's power (incoherent sum, patterns applied). Each bin
is treated alone: a weak echo far away is never compared with a strong one nearby.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.table import PathTable
from shared.physics.compiled import compiled, inlined
from shared.physics.units import db_to_power
from shared.physics.vectors import Index, Mask, Real
from shared.radar import Radar

BITS = 13
"""Of a digit: the counts of its values, 4 bytes each, fill a first-level cache of 32 KiB."""
RANGE_CELL_M = 0.15
U_CELL = 1.0 / 128.0
RATE_CELL_MPS = 0.19
"""Resolution of the default radar's truth in range, u and range rate. A trace serves every radar, and a finer one finds
fewer paths in its cells: their power is right, their speckle coarser.
"""
DEFAULT_LEVEL_DB = -40.0
"""Ten dB below the default error budget of -30 dB."""
UNPRUNED_DB = -200.0
"""Keeps every path that float64 can tell from zero."""


@compiled()
def rising(numbers):
    """[n] int64 indices that bring ``numbers`` [n] int64 into rising order, equal ones as they come: a radix sort.

    Digit by digit, the lowest first, the numbers are dealt to the places that their counts leave them (Knuth, The Art
    of Computer Programming, volume 3, section 5.2.5). It takes as many passes as the numbers' span has digits: a fifth
    of :func:`numpy.argsort`'s time for 450 000 numbers that span 38 bits, and for 250 000 that span 63.

    The numbers span less than 2**63, and n is below 2**32.
    """
    count = len(numbers)
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    least = numbers.min()
    span = np.uint64(numbers.max() - least)
    rest, order = np.empty(count, dtype=np.uint64), np.empty(count, dtype=np.uint32)
    for k in range(count):
        rest[k], order[k] = np.uint64(numbers[k] - least), k
    dealt, order_dealt = np.empty_like(rest), np.empty_like(order)
    place = np.empty(1 << BITS, dtype=np.uint32)
    digit, shift = np.uint64((1 << BITS) - 1), np.uint64(0)
    while span > 0:
        place[:] = 0
        for k in range(count):
            place[(rest[k] >> shift) & digit] += np.uint32(1)
        ahead = np.uint32(0)
        for value in range(len(place)):
            here = place[value]
            place[value] = ahead
            ahead += here
        for k in range(count):
            own = (rest[k] >> shift) & digit
            to = place[own]
            place[own] = to + np.uint32(1)
            dealt[to], order_dealt[to] = rest[k], order[k]
        rest, dealt = dealt, rest
        order, order_dealt = order_dealt, order
        span >>= np.uint64(BITS)
        shift += np.uint64(BITS)
    return order.astype(np.int64)


@inlined()
def cell_of(range_m, u, range_rate_mps):
    """Number of the cell of a path, in no order.

    :param range_m: half of the path's length, below 1e5 m; :param u: y / r of its arrival, -1 to 1
    :param range_rate_mps: its change, below 1e4 m/s
    """
    row, column = int(np.floor(range_m / RANGE_CELL_M)), int(np.floor((u + 1.0) / U_CELL))
    return ((row << 9) + column << 18) + int(np.rint(range_rate_mps / RATE_CELL_MPS)) + 2**17


def thinned(cell: Index, power: Real, most: int, random: np.random.Generator) -> tuple[Index, Real]:
    """Indices [k] of the paths that are kept, rising, and the factors [k] on their powers.

    :param cell: [n] number of each path's cell; :param power: [n] at least 0; those without are left out
    :param most: K of the module; 0 keeps all
    :param random: draws one number a cell
    """
    lit = np.flatnonzero(power > 0.0)
    if most == 0 or not len(lit):
        return lit, np.ones(len(lit))
    order = lit[rising(cell[lit])]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(cell[order])) + 1, [len(order)]])
    factor = _factors(order, starts, power, most, random.random(len(starts) - 1))
    kept = np.flatnonzero(factor)
    return kept, factor[kept]


@compiled()
def _factors(order, starts, power, most, shift):
    """[n] factor on the power of every path, 0 of those that are left out.

    :param order: paths, cell by cell, rising within a cell; :param starts: of the cells in ``order``, and its end
    :param shift: of each cell's systematic sampling, 0 to 1
    """
    factor, widest = np.zeros(len(power)), 0
    for number in range(len(starts) - 1):  # np.diff takes half a second to compile
        widest = max(widest, starts[number + 1] - starts[number])
    large = np.zeros(widest, dtype=np.bool_)
    for number in range(len(starts) - 1):
        first, last = starts[number], starts[number + 1]
        count = last - first
        if count <= most:
            for place in range(first, last):
                factor[order[place]] = 1.0
            continue
        members = order[first:last]
        large[:count] = False
        wanted, more = most, True
        while more:
            rest, more = 0.0, False
            for i in range(count):
                if not large[i]:
                    rest += power[members[i]]
            left = wanted
            for i in range(count):
                if not large[i] and power[members[i]] * left >= rest:
                    large[i], more, wanted = True, True, wanted - 1
        running, before = 0.0, 0.0
        for i in range(count):
            k = members[i]
            if large[i]:
                factor[k] = 1.0
                continue
            share = power[k] / rest
            running += share
            until = wanted * running if i < count - 1 else float(wanted)
            if np.floor(until + shift[number]) > np.floor(before + shift[number]):
                factor[k] = 1.0 / (wanted * share)
            before = until
    return factor


def pruned(paths: PathTable, radar: Radar, level_db: float = DEFAULT_LEVEL_DB) -> PathTable:
    """The table without its scattered paths whose sum in their range bin stays below ``level_db``; the rest is counted.

    :param paths: illuminated paths
    """
    scattered = paths.scattered
    range_bin = np.floor(scattered.range_m() / radar.waveform.range_step_m).astype(np.int64)
    keep = ~_negligible(np.abs(scattered.amplitude) ** 2, range_bin, float(db_to_power(level_db)))
    counts = {**paths.counts, "pruned": int((~keep).sum())}
    return replace(paths, scattered=scattered.take(keep), counts=counts)


def _negligible(power: Real, group: Index, share: float) -> Mask:
    """[K] whether a member belongs to the weakest of its group that hold at most ``share`` of the group's power."""
    if not len(group):
        return np.zeros(0, dtype=bool)
    group = group - group.min()
    return _weakest(_by_group_and_power(group, power), group, power, np.bincount(group, power), share)


@compiled()
def _weakest(order, group, power, total, share):
    """[K] as :func:`_negligible`.

    :param order: of the members, group by group, within a group the weakest first; :param total: power of each group
    """
    result = np.empty(len(order), dtype=np.bool_)
    before, held = -1, 0.0
    for k in order:
        held = power[k] + (held if group[k] == before else 0.0)
        before = group[k]
        result[k] = held <= share * total[before]
    return result


def _by_group_and_power(group: Index, power: Real) -> Index:
    """``np.lexsort((power, group))``: floats from 0 on rise with their bits."""
    order = rising(power.view(np.int64))
    return order[rising(group[order])]
