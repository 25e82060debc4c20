"""The cells of a frame about which lines are fitted, and which of their neighbours in range are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trainer.estimators.array import LineArray, uniform_axis
from trainer.estimators.fitting import SEARCH_POINTS
from trainer.estimators.moves import beside_lines

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
