"""Resolution cells: what paths they hold, fewer paths of the same power in them, and none of the weakest.

**Density.** A rough surface's echo in a cell is the sum of many contributions. Where only a few rays stand for it, the
cell shows the rays rather than the surface. Such cells are counted (docs/notes/speckle.md).

**Thinning.** A cell of range, u and range rate with more than K paths keeps K of them. Paths that hold 1/K of the
cell's power or more stay as they are. Of the others, of power P together, as many as are left of K are drawn, k of
them, with probabilities k p_i / P (systematic sampling, Madow 1949), and each that is drawn has the power P / k. The
cell's power is therefore what all its rays say, exactly, and that of any part of the cell is so on average. K random
phases of equal power make speckle whose intensity has the variance 1 - 1/K of fully developed speckle (Goodman, Speckle
Phenomena in Optics, section 3.6).

**Pruning.** The weakest scattered paths of each range-Doppler cell are left out, as many as hold together at most a
given share of their cell's power (incoherent sum, patterns applied): a weak echo far away is not compared with a strong
one nearby, nor a walker with the wall that stands at its range. Echoes of point targets are few, and stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from datafactory.paths.table import TARGET, PathTable
from shared.physics.compiled import compiled, inlined
from shared.physics.units import db_to_power
from shared.physics.vectors import Index, Mask, Real, lengths
from shared.radar import Radar
from shared.signal.windows import angle_window, width_and_sidelobe

FEW_PATHS = 5
"""Below five the amplitude of the sum is visibly not Rayleigh distributed."""
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


def lit_cells(paths: PathTable, radar: Radar) -> dict[str, int]:
    """Resolution cells of the truth that scattered paths light, and how many of them fewer than five.

    A cell is one range bin by the virtual sensor's Rayleigh length in u, lambda / (elements * spacing).
    """
    scattered, grid = paths.scattered, radar.grid
    y = radar.virtual_sensor.rx[:, 1]
    aperture = float(np.ptp(y)) * len(y) / max(len(y) - 1, 1)
    width = radar.waveform.wavelength_m / aperture if aperture > 0.0 else 2.0
    distance = lengths(scattered.rx_point)
    u = scattered.rx_point[:, 1] / np.where(distance > 0.0, distance, 1.0)
    row = np.floor(scattered.range_m() / radar.waveform.range_step_m).astype(np.int64)
    inside = (row < radar.waveform.range_bins) & (u >= grid.u_start) & (u < grid.u_stop)
    column = np.floor((u[inside] - grid.u_start) / width).astype(np.int64)
    paths_in = np.bincount(row[inside] * (int(2.0 / width) + 1) + column)
    lit = paths_in[paths_in > 0]
    return {"cells_lit": len(lit), "cells_lit_by_fewer_than_5_paths": int((lit < FEW_PATHS).sum())}


@dataclass(frozen=True, eq=False)
class CellMap:
    """Which resolution cell of the truth each path lies in, scattered paths first.

    Cells are one range bin times the truth's -3 dB width in u.

    :param shape: R, U'
    :param cell: [K] number of the path's cell, row by row; that of the first for paths beyond the last range bin
    :param power: [K] of the path [W]; 0 for paths beyond the last range bin
    """

    shape: tuple[int, int]
    cell: Index
    power: Real

    def sums(self, weight: Real | float = 1.0) -> Real:
        """[R, U'] power [W] of the paths in every cell, summed without phase.

        That is the expectation of |sum A|^2 over random phases (Goodman, Speckle Phenomena in Optics, section 2.1), so
        that no image of many realisations is needed.

        :param weight: of each path's power, or of all
        """
        sums = np.bincount(self.cell, self.power * weight, self.shape[0] * self.shape[1])
        return sums.astype(np.float64, copy=False).reshape(self.shape)


def cell_map(paths: PathTable, radar: Radar, truth_window: str) -> CellMap:
    """The cells of a table's paths.

    :param truth_window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    """
    power = np.abs(paths.every("amplitude")) ** 2
    row, column, columns = cell_numbers(paths.range_m(), paths.arrival(), radar, truth_window)
    inside = row < radar.waveform.range_bins
    cell = np.where(inside, row * columns + column, 0)
    return CellMap((radar.waveform.range_bins, columns), cell, np.where(inside, power, 0.0))


def cell_numbers(range_m: Real, arrival: Real, radar: Radar, truth_window: str) -> tuple[Index, Index, int]:
    """Range bin [K] and column in u [K] of echoes, and the number of columns: one range bin times the truth's -3 dB
    width.

    :param range_m: [K] [m]; :param arrival: [K, 3] points from which they come [m]
    """
    width = min(_width_in_u(radar, truth_window), 2.0)
    columns = int(np.ceil(2.0 / width))
    row = np.rint(range_m / radar.waveform.range_step_m).astype(np.int64)
    return row, np.clip(((_u_of(arrival) + 1.0) / width).astype(np.int64), 0, columns - 1), columns


def share_on_grid(arrival: Real, radar: Radar, truth_window: str) -> Real:
    """[K] of the power of echoes, what the truth's image shows of them: all within its first and last bin of u.

    At the distance d beyond, the main lobe of -3 dB width w leaves 10^(-0.3 (2 d / w)^2) at the edge. The image of
    elements in line repeats in u with the wavelength over their spacing. Sidelobes are not counted.

    :param arrival: [K, 3] points from which they come [m]
    """
    width = _width_in_u(radar, truth_window)
    if np.isinf(width):
        return np.ones(len(arrival))
    bins, period = radar.grid.u, 1.0 / _spacing(radar)
    half, middle = 0.5 * (bins[-1] - bins[0]), 0.5 * (bins[-1] + bins[0])
    off = _u_of(arrival) - middle
    off -= period * np.rint(off / period)
    return db_to_power(-3.0 * (2.0 * np.maximum(np.abs(off) - half, 0.0) / width) ** 2)


def _u_of(arrival: Real) -> Real:
    return arrival[:, 1] / np.maximum(lengths(arrival), 1e-9)


def _spacing(radar: Radar) -> float:
    """Of the virtual sensor's elements across, in wavelengths; 0 of one that tells no angle."""
    sensor = radar.virtual_sensor
    return float(np.ptp(sensor.rx[:, 1])) / max(sensor.channels - 1, 1) / radar.waveform.wavelength_m


def _width_in_u(radar: Radar, truth_window: str) -> float:
    """-3 dB width of the truth's image; infinite of a sensor that tells no angle."""
    spacing = _spacing(radar)
    return _width_of_line(truth_window, radar.virtual_sensor.channels, spacing) if spacing > 0.0 else np.inf


@lru_cache(maxsize=8)
def _width_of_line(truth_window: str, elements: int, spacing: float) -> float:
    return width_and_sidelobe(angle_window(truth_window, elements), spacing)[0]


def cell_power(paths: PathTable, radar: Radar, truth_window: str, weight: Real | float = 1.0) -> Real:
    """[R, U'] power [W] of the paths in every resolution cell of the truth, see :meth:`CellMap.sums`."""
    return cell_map(paths, radar, truth_window).sums(weight)


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
    """The table without its scattered paths whose sum in their range-Doppler cell stays below ``level_db``, which are
    counted; point targets' echoes all stay.

    :param paths: illuminated paths
    """
    scattered, waveform = paths.scattered, radar.waveform
    start_m, middle_s = scattered.range_m(), waveform.mid_frame_s  # the mean rate until then is the cell's
    rate_mps = (paths.at_rest(middle_s).scattered.range_m() - start_m) / middle_s
    range_bin = np.floor(start_m / waveform.range_step_m).astype(np.int64)
    cell = range_bin * waveform.chirps + waveform.doppler_cells(rate_mps)
    weak = _negligible(np.abs(scattered.amplitude) ** 2, cell, float(db_to_power(level_db)))
    keep = ~weak | (scattered.kinds & TARGET > 0)
    counts = {**paths.counts, "pruned": int((~keep).sum())}
    return replace(paths, scattered=scattered.take(keep), counts=counts)


def _negligible(power: Real, group: Index, share: float) -> Mask:
    """[K] whether a member belongs to the weakest of its group that hold at most ``share`` of the group's power."""
    if not len(group):
        return np.zeros(0, dtype=bool)
    group = group - group.min()
    order = rising(power.view(np.int64))  # floats from 0 on rise with their bits
    return _weakest(order[rising(group[order])], group, power, np.bincount(group, power), share)


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
