"""The cells of a frame about which lines are fitted; and which lines of all groups are targets: each once, no sidelobe,
no ghost of an imperfect board, no sideband.

A target belongs to the group of its own bin: of the groups that see it the one with most energy lists it, and lists all
that it has resolved there. A line is none that the window's sidelobes of a stronger one explain, alone or with what
noise may add.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.units import amplitude_to_db, db_to_amplitude, db_to_power
from shared.signal.windows import hann_envelope_db
from trainer.estimators.array import LineArray, uniform_axis
from trainer.estimators.fitting import SEARCH_POINTS
from trainer.estimators.lines import beside_lines

MOST_BINS = 1 << 32
"""More than a range axis has."""


@dataclass(frozen=True, eq=False)
class Centres:
    """The n cells about which groups are made, in their order.

    :param cells: [D, R] Doppler cell of each peak of the frame, from minus half of the chirps on
    :param new: [D, R] whether it repeats no earlier one of its range bin
    :param peak, row: [n] of the centres
    """

    cells: NDArray[np.int64]
    new: NDArray[np.bool_]
    peak: NDArray[np.intp]
    row: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.row)

    @property
    def cell(self) -> NDArray[np.int64]:
        """[n] Doppler cell of each."""
        return self.cells[self.peak, self.row]

    def holding(self, cell: NDArray[np.int64], row: NDArray[np.intp]) -> NDArray[np.intp]:
        """[k] which peak of a range bin holds a Doppler cell [k], -1 where none does, or there is no such bin [k]."""
        there = np.clip(row, 0, self.cells.shape[1] - 1)
        same = (self.cells[:, there] == cell) & self.new[:, there] & (there == row)
        return np.where(same.any(axis=0), same.argmax(axis=0), -1)

    def are_at(self, cell: NDArray[np.int64], row: NDArray[np.intp]) -> NDArray[np.bool_]:
        """[k] whether there is a centre in a Doppler cell [k] of a range bin [k]."""
        return np.isin(_place(cell, row), _place(self.cell, self.row))

    def patterns(self) -> Iterator[tuple[dict[int, NDArray[np.intp]], NDArray[np.intp]]]:
        """By which neighbouring bins hold a centre's Doppler cell too: ({bins from it: [m] peaks}, [m] the centres)."""
        beside = {step: self.holding(self.cell, self.row + step) for step in (-1, 1)}
        for left in (False, True):
            for right in (False, True):
                members = np.flatnonzero(((beside[-1] >= 0) == left) & ((beside[1] >= 0) == right))
                if len(members):
                    steps = [-1] * left + [0] + [1] * right
                    yield {step: (beside[step] if step else self.peak)[members] for step in steps}, members


def heard_centres(
    snapshots: NDArray[np.complexfloating],
    cells: NDArray[np.int64],
    new: NDArray[np.bool_],
    about: NDArray[np.bool_],
    array: LineArray,
    least: float,
) -> Centres:
    """The strongest cell in which an angle takes more than ``least`` [W]; the next strongest if it is no neighbour of a
    stronger one in range; and so on.

    :param snapshots: [D, R, C], each bin straightened for its range
    :param cells, new: see :class:`Centres`; :param about: [D, R] the cells that may be a centre
    """
    peak, row = np.nonzero(about)
    values = np.asarray(snapshots, dtype=np.complex128)[peak, row]
    taking = beside_lines(values, array, uniform_axis(array, SEARCH_POINTS), np.empty((len(values), 0)))[0].max(axis=1)
    heard = taking > least
    peak, row, taking = peak[heard], row[heard], taking[heard]
    places, beside = _place(cells[peak, row], row).tolist(), set[int]()
    kept = []
    for index in np.argsort(-taking, kind="stable").tolist():
        if places[index] not in beside:
            kept.append(index)
            beside |= {places[index] - 1, places[index] + 1}
    kept.sort()
    return Centres(cells, new, peak[kept], row[kept])


def _place(cell: NDArray[np.int64], row: NDArray[np.integer]) -> NDArray[np.int64]:
    """A number for each Doppler cell and range bin; that of the next bin is one more."""
    return cell * MOST_BINS + row


SAME_BINS = 1.0
"""Lines of different groups so near in range are one target's: groups of neighbouring bins fit it each for itself."""
LOBE_MARGIN_DB = 3.0
"""A line so far above what the window gives a stronger one there is a target of its own: twice its power, which noise
seldom adds."""
SIDEBAND_BINS, SIDEBAND_GUARD = 12, 2
"""How far to either side of a line the angle is listened at, and how far its own main lobe reaches: twenty bins, of
which the Hann window leaves about ten independent, and few enough for the sidebands to be alike in them."""
SIDEBAND_FACTOR = 18.0
"""Of the median power there: -ln(1e-4) times the mean, which is the median / ln 2 of an exponential distribution, and
1.4 dB more, since a line stands where it is strongest, between bins too."""
DISPLACED = 3.0
"""Standard deviations, by which noise may have displaced a sidelobe from the angle of its line."""


@dataclass(frozen=True, eq=False)
class Beams:
    """What a frame's cells hold of a wave front.

    :param snapshots: [D, R, C], each bin straightened for its range
    :param cells: [D, R] the Doppler cell of each
    :param range_m: [R] of the bins
    """

    snapshots: NDArray[np.complexfloating]
    cells: NDArray[np.int64]
    range_m: NDArray[np.float64]
    array: LineArray

    def front(self, range_m: float, u: float) -> NDArray[np.complex128]:
        """[R, C] the front that comes from a place, as it stands in each bin."""
        bend = self.array.bend_phase(np.array([range_m])) * (1.0 - u**2) - self.array.bend_phase(self.range_m)
        return np.asarray(self.array.manifold(u) * np.exp(1j * bend))

    def in_cell(self, cell: int) -> NDArray[np.complex128]:
        """[R, C] the bins' values in a Doppler cell; NaN where it is not known."""
        values = np.full(self.snapshots.shape[1:], np.nan, dtype=np.complex128)
        peak, row = np.nonzero(self.cells == cell)
        values[row] = self.snapshots[peak, row]
        return values


@dataclass(frozen=True, eq=False)
class Lines:
    """N lines of all groups.

    :param chirps: Doppler cells, a circle
    :param around: range bins after which the axis comes round; infinite of one that does not hold all that was sampled
    :param place: [N] range bin with its fraction; :param cell: [N] Doppler cell
    :param group: [N] index of the centre; :param energy: [N] of the group's cells, all channels' mean [W]
    :param noise: [N] of one channel and cell, with the model error of the group's strongest cell [W]
    :param u, offset: [N] angle, and range bins from the centre; :param u_std, offset_std: [N] their deviations
    :param level_db: [N] of the amplitude [dB re 1 sqrt(W)]
    :param shift: [N] Doppler cells from the centre's; :param shift_std: [N] its deviation
    """

    chirps: int
    around: float
    place: NDArray[np.float64]
    cell: NDArray[np.int64]
    group: NDArray[np.intp]
    energy: NDArray[np.float64]
    noise: NDArray[np.float64]
    u: NDArray[np.float64]
    offset: NDArray[np.float64]
    level_db: NDArray[np.float64]
    u_std: NDArray[np.float64]
    offset_std: NDArray[np.float64]
    shift: NDArray[np.float64]
    shift_std: NDArray[np.float64]

    def _apart(self, index: int, others: NDArray[np.intp]) -> tuple[NDArray, NDArray]:
        """How far others are from a line, range bins and Doppler cells, the short way round."""
        cells = (self.cell[others] - self.cell[index] + 0.5 * self.chirps) % self.chirps - 0.5 * self.chirps
        bins = np.abs(self.place[others] - self.place[index])
        return np.minimum(bins, self.around - bins), np.abs(cells)

    def once(self, lines: NDArray[np.intp], near: float) -> NDArray[np.intp]:
        """Those that no group of more energy has at the same place."""
        order = lines[np.lexsort((self.group[lines], -self.energy[lines]))]
        kept = np.zeros(len(self.u), dtype=bool)
        for index, beside in self._neighbours(order, near):
            others = beside[kept[beside] & (self.group[beside] != self.group[index])]
            bins, cells = self._apart(index, others)
            kept[index] = not ((bins < SAME_BINS) & (cells < 0.5)).any()
        return order[kept[order]]

    def explained_by_none(self, lines: NDArray[np.intp], near: float, noise: float) -> NDArray[np.intp]:
        """The strongest first; without those that a stronger one's window explains, or it and ``noise`` [sqrt(W)]."""
        order = lines[np.argsort(-self.level_db[lines], kind="stable")]
        kept = np.zeros(len(self.u), dtype=bool)
        for index, beside in self._neighbours(order, near + DISPLACED * self.u_std[order]):
            others = beside[kept[beside] & (self.group[beside] != self.group[index])]
            bins, cells = self._apart(index, others)
            window = hann_envelope_db(np.maximum(bins - 0.5, 0.0)) + hann_envelope_db(np.maximum(cells - 0.5, 0.0))
            there = (bins >= SAME_BINS) | (cells > 0.5)
            explained = db_to_amplitude(self.level_db[others] + window + LOBE_MARGIN_DB) + noise
            kept[index] = not (there & (self.level_db[index] < amplitude_to_db(explained))).any()
        return order[kept[order]]

    def no_ghosts(self, lines: NDArray[np.intp], array: LineArray, error: float) -> NDArray[np.intp]:
        """Those above what elements that err, by ``error`` of the power, make of stronger lines in the same cell."""
        power = db_to_power(self.level_db)
        kept = np.ones(len(lines), dtype=bool)
        for place, index in enumerate(lines if error > 0.0 else ()):
            above = lines[power[lines] > power[index]]
            same = (self.cell[above] == self.cell[index]) & (np.abs(self.place[above] - self.place[index]) < SAME_BINS)
            beside = above[same]
            ghost = error * np.sum(power[beside] * array.ghost_share(self.u[beside] - self.u[index]))
            kept[place] = power[index] > ghost
        return lines[kept]

    def no_sidebands(self, lines: NDArray[np.intp], beams: Beams, below_db: float) -> NDArray[np.intp]:
        """Those that stand out of the sidebands of each line so far above them in their Doppler cell.

        An oscillator's phase noise spreads an echo over all range bins, with the wave front of the echo, alike in all
        channels. How strong it is there, the bins around a line tell. What it puts into other Doppler cells is not
        looked for.

        :param lines: [n] indices; :param below_db: from a line to the sidebands that are looked for, at least [dB]
        :returns: indices of those kept, in their order
        """
        level_db, kept = self.level_db[lines], np.ones(len(lines), dtype=bool)
        nearest = np.clip(np.rint(self.place[lines]).astype(np.intp), 0, len(beams.range_m) - 1)
        for strong in lines[level_db - level_db.min(initial=np.inf) > below_db]:
            below = (level_db < self.level_db[strong] - below_db) & (self.cell[lines] == self.cell[strong])
            weak = np.flatnonzero(below & kept)
            front = beams.front(self.place[strong] * beams.range_m[1], self.u[strong])
            seen, own = beams.in_cell(self.cell[strong]), beams.array.manifold(self.u[lines[weak]]).T
            share = _mean_power(own.conj() * front[nearest[weak]])
            sidebands = share * _around(_mean_power(seen * front.conj()), nearest[weak])
            # A line has the larger power of the bins on its two sides, of which its group's own is known.
            lower = np.clip(self.place[lines[weak]].astype(np.intp), 0, len(seen) - 2)
            sides = np.stack([_mean_power(own.conj() * seen[lower + step]) for step in (0, 1)])
            kept[weak] = np.fmax(*sides) > SIDEBAND_FACTOR * sidebands
        return lines[kept]

    def _neighbours(
        self, order: NDArray[np.intp], near: float | NDArray[np.float64]
    ) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """(line, those of ``order`` so near its angle), one after the other."""
        by_angle = order[np.argsort(self.u[order], kind="stable")]
        first = np.searchsorted(self.u[by_angle], self.u[order] - near, side="left")
        last = np.searchsorted(self.u[by_angle], self.u[order] + near, side="right")
        for index, start, stop in zip(order.tolist(), first, last, strict=True):
            yield index, by_angle[start:stop]


def _mean_power(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    """[n] power of the mean over channels of values [n, C]."""
    return np.asarray(np.abs(np.mean(values, axis=1)) ** 2)


def _around(power: NDArray[np.float64], rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """[n] median of what is known of a power [R] around range bins; 0 where that is less than half."""
    apart = np.arange(SIDEBAND_GUARD + 1, SIDEBAND_BINS + 1)
    padded = np.pad(power, SIDEBAND_BINS, constant_values=np.nan)
    around = padded[rows[:, None] + SIDEBAND_BINS + np.concatenate([-apart, apart])]
    known = np.count_nonzero(np.isfinite(around), axis=1) >= len(apart)
    result = np.zeros(len(rows))
    result[known] = np.nanmedian(around[known], axis=1)
    return result
