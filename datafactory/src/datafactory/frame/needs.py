"""Which effects of the signal a frame calls for, from its own paths alone.

An effect is called for where leaving it out would change a resolution cell by more than the error budget (of the
strongest cell's power), or more than a tenth of the cells above the noise by half a decibel. What changes, path by
path, are the formulas of :mod:`datafactory.frame.changes`. Most decisions need few of them. The strongest cell is
looked at first: what changes it by more than the budget is called for. Where a closed-form bound keeps both limits, the
sum over cells is spared: no cell changes by a greater share than its most changed path.

The decision is a function of the frame's illuminated paths, the radar and the budget. It knows nothing of other frames,
so that a frame is the same rendered alone, by any worker, or from stored paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from datafactory.frame import changes
from datafactory.paths.density import CellMap, cell_map
from datafactory.paths.rising import rising
from datafactory.paths.table import PathTable
from shared.physics.units import db_to_power
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.windows import cell_noise_power

Real = NDArray[np.float64]

FRAME_EFFECTS = ("doppler", "range_migration", "intra_chirp_motion", "near_field", "antenna_pattern", "noise")
"""Effects that work on the paths that there are: these are decided frame by frame."""
OCCUPIED_SHARE = 0.1
"""Of the cells above the noise; those that change by more than half a decibel count."""
HALF_A_DECIBEL = 0.12
"""As a share of a cell's power."""
NOISE_MARGIN = 1e3
"""A range bin whose strongest echo is less than 30 dB above the noise shows it."""
REST = 1e-3
"""See :func:`curved_share`."""
FIRST_BLOCK = 1_000
"""Paths whose exact change is computed first, the most important ones; of plane waves then twice as many, and so on."""


@dataclass(frozen=True)
class Cells:
    """Power in the truth's resolution cells, and what counts as occupied.

    :param where: the cell of each path
    :param total: [R, U'] [W]; :param occupied: [R, U'] whether it exceeds the noise of the input's image
    """

    where: CellMap
    total: Real
    occupied: NDArray[np.bool_]

    @property
    def peak(self) -> float:
        """Of the strongest cell [W]."""
        return float(self.total.max(initial=0.0))

    @cached_property
    def strongest(self) -> NDArray[np.int64]:
        """[<= ``FIRST_BLOCK``] the strongest paths of the strongest cell, rising."""
        there = np.flatnonzero(self.where.cell == self.total.argmax())
        if len(there) > FIRST_BLOCK:
            there = np.sort(there[np.argsort(-self.where.power[there], kind="stable")[:FIRST_BLOCK]])
        return there

    def peak_changes(self, share: Real, budget_db: float) -> bool:
        """Whether the strongest cell alone changes by too much to leave out.

        :param share: [len(strongest)] of the power of ``strongest`` that changes
        """
        return float(self.where.power[self.strongest] @ share) > float(db_to_power(budget_db)) * self.peak

    def changed_share(self, changed: Real) -> float:
        """Share of the occupied cells that change by more than half a decibel.

        :param changed: [R, U'] power of the change [W]
        """
        if not self.occupied.any():
            return 0.0
        return float(np.mean(changed[self.occupied] > HALF_A_DECIBEL * self.total[self.occupied]))

    def called_for(self, changed: Real, budget_db: float) -> bool:
        """Whether a change of this power is too large to leave out."""
        over_peak = float(changed.max(initial=0.0)) > float(db_to_power(budget_db)) * self.peak
        return over_peak or self.changed_share(changed) > OCCUPIED_SHARE


def cells_of(paths: PathTable, radar: Radar, truth_window: str) -> Cells:
    """The cells of a frame's illuminated paths."""
    where = cell_map(paths, radar, truth_window)
    total = where.sums()
    return Cells(where, total, total > cell_noise_power(radar) / radar.array.channels)


def effects_called_for(paths: PathTable, radar: Radar, truth_window: str, budget_db: float) -> frozenset[str]:
    """Those of ``FRAME_EFFECTS`` that a frame cannot do without.

    Motion within frame and chirp mean nothing without Doppler. A frame in which nothing moves calls for none of them,
    whatever the budget.

    :param paths: all of the frame's, illuminated
    :param budget_db: what leaving one effect out may change [dB of the strongest cell's power]
    """
    waveform, front_end = radar.waveform, radar.front_end
    cells = cells_of(paths, radar, truth_window)
    least = min(float(db_to_power(budget_db)), HALF_A_DECIBEL)
    at_peak = _taken(paths, cells.strongest)

    def called_for(change: Callable[[PathTable], Real]) -> bool:
        """:param change: of paths the amplitudes' change [K]; its square is the share of their power"""
        if cells.peak_changes(change(at_peak) ** 2, budget_db):
            return True
        share = change(paths) ** 2
        if not float(share.max(initial=0.0)) > least:
            return False
        return cells.called_for(cells.where.sums(share), budget_db)

    rates_of_all = cache(partial(changes.range_rates_mps, paths, waveform))

    def by_rate(change: Callable[[Real, Waveform], Real]) -> Callable[[PathTable], Real]:
        return lambda some: change(
            rates_of_all() if some is paths else changes.range_rates_mps(some, waveform), waveform
        )

    found = set()
    if paths.moves() and waveform.chirps > 1 and called_for(by_rate(changes.doppler_change)):
        found.add("doppler")
        if called_for(by_rate(changes.migration_change)):
            found.add("range_migration")
        if called_for(by_rate(changes.intra_chirp_change)):
            found.add("intra_chirp_motion")
    if _curved(paths, at_peak, cells, radar, budget_db):
        found.add("near_field")
    isotropic = front_end.tx_pattern.kind == front_end.rx_pattern.kind == "isotropic"
    if not isotropic and called_for(partial(changes.pattern_change, radar=radar)):
        found.add("antenna_pattern")
    if noisy_share(cells, radar) > 0.0:
        found.add("noise")
    return frozenset(found)


def noisy_share(cells: Cells, radar: Radar) -> float:
    """Share of the range bins in which no echo is 30 dB above the receiver's noise."""
    return float(np.mean(cells.total.max(axis=1) < NOISE_MARGIN * cell_noise_power(radar)))


def _curved(paths: PathTable, at_peak: PathTable, cells: Cells, radar: Radar, budget_db: float) -> bool:
    """Whether spherical waves over the input array are called for.

    The exact change takes a wave's phase at every channel. It is computed for the paths that the closed-form bound
    finds most important, until what the rest can add at most no longer matters.

    :param at_peak: the paths ``cells.strongest``
    """
    array, wavelength, where = radar.array, radar.waveform.wavelength_m, cells.where
    if cells.peak_changes(changes.plane_wave_change(at_peak, array, wavelength) ** 2, budget_db):
        return True
    bound = changes.plane_wave_bound(paths, array, wavelength) ** 2
    if not cells.called_for(where.sums(bound), budget_db):
        return False
    order = rising(-(where.power * bound).view(np.int64))  # floats from 0 on rise with their bits
    known = np.zeros_like(cells.total)
    for block, rest in _growing_blocks(order):
        exact = changes.plane_wave_change(_taken(paths, block), array, wavelength) ** 2
        known += where.sums(exact, block)
        if cells.called_for(known, budget_db):
            return True
        if not cells.called_for(known + where.sums(bound[rest], rest), budget_db):
            return False
    return False


def curved_share(paths: PathTable, cells: Cells, radar: Radar) -> Real:
    """[K] share of each path's power that plane waves over the input array would change.

    Exact for the paths that matter most; of the rest, which add no more than ``REST`` of the sum, the bound.
    """
    array, wavelength, power = radar.array, radar.waveform.wavelength_m, cells.where.power
    share = changes.plane_wave_bound(paths, array, wavelength) ** 2
    order = np.argsort(-power * share, kind="stable")
    known = 0.0
    for block, rest in _growing_blocks(order):
        share[block] = changes.plane_wave_change(_taken(paths, block), array, wavelength) ** 2
        known += float(power[block] @ share[block])
        if float(power[rest] @ share[rest]) <= REST * known:
            break
    return share


def _growing_blocks(order: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """A block, its paths rising, and all that come after it: 1000 paths, then 2000, 4000, ..."""
    done, size = 0, FIRST_BLOCK
    while done < len(order):
        yield np.sort(order[done : done + size]), order[done + size :]
        done, size = done + size, 2 * size


def _taken(paths: PathTable, index: NDArray[np.int64]) -> PathTable:
    """Some of a table's paths.

    :param index: rising; scattered paths are counted first
    """
    first = int(np.searchsorted(index, len(paths.scattered)))
    scattered, specular = index[:first], index[first:] - len(paths.scattered)
    return replace(paths, scattered=paths.scattered.take(scattered), specular=paths.specular.take(specular))
