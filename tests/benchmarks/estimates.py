"""How far the estimates of second bounces scatter: ``python tests/benchmarks/estimates.py SCENE --frames N``.

Of waves mirrored and then scattered, each thin share of a frame's rays gives an estimate; of waves scattered twice,
each of as many seeds. Printed of each frame is their standard deviation over their mean, of the strongest cell of the
truth, which is held against the frame's limit, and of all cells together; and how many, times ``SURE``, are below what
all of them together say of that cell.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer

from datafactory.api.asking import materials_of, order_of
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import SceneSource
from datafactory.paths import scattered, trace
from datafactory.paths.candidates import MIRRORED, Candidates
from datafactory.paths.cells import cell_numbers
from datafactory.paths.notice import Notice
from datafactory.run.preparation import prepare
from shared.physics.vectors import Real


class Kept(scattered.SecondBounces):
    """The last frame's, with what it was made of."""

    last: Kept

    def __init__(self, first: scattered.Arrivals, seed: int) -> None:
        super().__init__(first, seed)
        self.first, self.each, Kept.last = first, self._each, self

    def estimates(self, group: int) -> list[Candidates]:
        """As many as there are thin shares."""
        if group != MIRRORED:
            return [joined(group, scattered.scattered_twice(self.first, seed), 1) for seed in range(self.each)]
        shares = [[of.take(of.arrivals.ray % self.each == k) for of in self.echoes(group)] for k in range(self.each)]
        return [joined(group, share, self.each) for share in shares]


def joined(group: int, echoes: list[scattered.Echoes], stands_for: int) -> Candidates:
    """The candidates of one share."""
    return Candidates.joined([Candidates.none(), *(scattered._estimates(group, of, stands_for) for of in echoes)])


def told(estimates: list[Candidates], notice: Notice) -> str:
    """One group of one frame."""
    cells = np.stack([sums(candidates, notice) for candidates in estimates])
    strongest = cells.max(axis=1)
    error, whole = (values.std(ddof=1) / values.mean() for values in (strongest, cells.sum(axis=1)))
    missed = (scattered.SURE * strongest < cells.mean(axis=0).max()).sum()
    return f"{len(cells)} estimates, strongest cell {error:.2f}, all cells {whole:.3f}, too low {missed}"


def sums(candidates: Candidates, notice: Notice) -> Real:
    """[cells] what a share says of each [W]."""
    range_m, arrival = candidates.range_m.astype(np.float64), candidates.arrival.astype(np.float64)
    row, column, columns = cell_numbers(range_m, arrival, notice.radar, notice.truth_window)
    bins = notice.radar.waveform.range_bins
    power = np.where(row < bins, notice.power_w(candidates), 0.0) / scattered.SURE
    found = np.bincount(np.minimum(row, bins - 1) * columns + column, power, bins * columns)
    return found.astype(np.float64, copy=False)


def main(scene: str, frames: Annotated[int, typer.Option()] = 6) -> None:
    """Print both groups of each frame."""
    order = order_of(OrderOptions(scenes=scene, frames=frames))
    job, notice = prepare(order, materials_of(None)).job, order.of_scenes.notice(order.radar)
    assert notice is not None
    trace.SecondBounces = Kept  # type: ignore[misc]
    for frame_id in range(frames):
        SceneSource(job.deal.frame(frame_id), job.scenes[0], job.of_scenes).traced(order.radar)
        for name, group in (("mirrored", MIRRORED), ("twice", scattered.TWICE)):
            print(frame_id, name, told(Kept.last.estimates(group), notice), flush=True)


if __name__ == "__main__":
    typer.run(main)
