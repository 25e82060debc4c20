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

Real = NDArray[np.float64]

RANGE_CELL_M = 0.15
U_CELL = 1.0 / 128.0
RATE_CELL_MPS = 0.19
"""Resolution of the default radar's truth in range, u and range rate. A trace serves every radar, and a finer one finds
fewer paths in its cells: their power is right, their speckle coarser.
"""


def cells_of(range_m: Real, u: Real, range_rate_mps: Real) -> NDArray[np.int64]:
    """[n] number of the cell of each path, in no order.

    :param range_m: [n] half of the path's length, below 1e5 m; :param u: [n] y / r of its arrival, -1 to 1
    :param range_rate_mps: [n] its change, below 1e4 m/s
    """
    row = np.floor(range_m / RANGE_CELL_M).astype(np.int64)
    column = np.floor((u + 1.0) / U_CELL).astype(np.int64)
    rate = np.rint(range_rate_mps / RATE_CELL_MPS).astype(np.int64) + 2**17
    return ((row << 9) + column << 18) + rate


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
    order = lit[np.argsort(cell[lit], kind="stable")]
    starts = np.diff(cell[order], prepend=cell[order[0]] - 1) != 0
    place, paths = np.cumsum(starts) - 1, power[order]
    counts = np.bincount(place)
    large = (counts <= most)[place]
    wanted, rest = _for_the_others(place, paths, large, most)
    while (more := ~large & (paths * wanted[place] >= rest[place])).any():
        large |= more
        wanted, rest = _for_the_others(place, paths, large, most)
    # Shares of the own cell: a running sum over strong cells would lose the digits of weak ones.
    share = np.divide(paths, rest[place], out=np.zeros_like(paths), where=~large)
    running = np.cumsum(share)
    first = np.flatnonzero(starts)
    until = wanted[place] * (running - (running[first] - share[first])[place])
    last = np.append(first[1:], len(order)) - 1
    until[last] = wanted
    before = np.concatenate([[0.0], until[:-1]])
    before[first] = 0.0
    shift = random.random(len(counts))[place]
    drawn = ~large & (np.floor(until + shift) > np.floor(before + shift))
    kept = large | drawn
    factor = np.divide(1.0, wanted[place] * share, out=np.ones_like(share), where=drawn)
    rising = np.argsort(order[kept])
    return order[kept][rising], factor[kept][rising]


def _for_the_others(
    place: NDArray[np.int64], power: Real, large: NDArray[np.bool_], most: int
) -> tuple[NDArray[np.int64], Real]:
    """How many paths each cell may keep besides the large ones, and the power of these others."""
    taken = np.bincount(place[large], minlength=int(place[-1]) + 1).astype(np.int64)
    return most - taken, np.bincount(place, weights=np.where(large, 0.0, power)).astype(np.float64)
