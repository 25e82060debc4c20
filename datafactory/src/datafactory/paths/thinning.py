"""Fewer paths of the same power: at most so many in a cell of range, u and range rate.

Rays are cheap and paths are dear: what a frame costs is the paths that are synthesised. Near the sensor a resolution
cell has hundreds of rays, far away it has one. A cell with more than K paths keeps K of them. Paths that hold 1/K of
the cell's power or more stay as they are. Of the others, of power P together, as many as are left of K are drawn, k of
them, with probabilities k p_i / P (systematic sampling, Madow 1949), and each that is drawn has the power P / k.

The cell's power is therefore what all its rays say, exactly, and that of any part of the cell is so on average. K
random phases of equal power make speckle whose intensity has the variance 1 - 1/K of fully developed speckle (Goodman,
Speckle Phenomena in Optics, section 3.6).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.rising import rising
from shared.physics.compiled import compiled, inlined

Real = NDArray[np.float64]

RANGE_CELL_M = 0.15
U_CELL = 1.0 / 128.0
RATE_CELL_MPS = 0.19
"""Resolution of the default radar's truth in range, u and range rate. A trace serves every radar, and a finer one finds
fewer paths in its cells: their power is right, their speckle coarser.
"""


@inlined()
def cell_of(range_m, u, range_rate_mps):
    """Number of the cell of a path, in no order.

    :param range_m: half of the path's length, below 1e5 m; :param u: y / r of its arrival, -1 to 1
    :param range_rate_mps: its change, below 1e4 m/s
    """
    row, column = int(np.floor(range_m / RANGE_CELL_M)), int(np.floor((u + 1.0) / U_CELL))
    return ((row << 9) + column << 18) + int(np.rint(range_rate_mps / RATE_CELL_MPS)) + 2**17


def thinned(
    cell: NDArray[np.int64], power: Real, most: int, random: np.random.Generator
) -> tuple[NDArray[np.int64], Real]:
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
    factor = np.zeros(len(power))
    large = np.zeros(np.diff(starts).max(), dtype=np.bool_)
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
