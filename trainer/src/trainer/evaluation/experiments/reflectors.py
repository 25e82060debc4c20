"""Two equal cylinders side by side (the paper's Fig. 10), simulated.

The paper gives their picture and not their distance; here they stand at 5.7 m, one resolution cell of the full array
apart, lambda / (span + spacing) = 0.041 in u. The figure shows one realisation of phases and noise, the numbers are
over many.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.data.pairs import resolution_cell
from trainer.data.simulation import CLOSE_UP_BINS, close_up, out_of_sight
from trainer.evaluation.experiments.bench import (
    KEPT,
    Bench,
    Results,
    Task,
    contender_task,
    radar_task,
    share_row,
)
from trainer.evaluation.experiments.cylinders import (
    RANGE_M,
    Echoes,
    cylinders,
    image_around,
    noisy_snapshot,
    truth_around,
)
from trainer.evaluation.report.levels import own_levels
from trainer.evaluation.report.panels import image_panels
from trainer.evaluation.rows import MetricRow, SummaryColumn
from trainer.evaluation.store import Values
from trainer.metrics.peaks import resolved, strongest_peaks

CENTRE_U = 0.05
MOST_REALISATIONS = 24
"""Each is a whole image for a network of whole images."""


class Reflectors:
    """Are two equal echoes told apart?"""

    name = "two-reflectors"
    cells = name
    title = "Two cylinders, one resolution cell of the full array apart (paper, Fig. 10)"
    caption = (
        "Two equal cylinders at 5.7 m, one resolution cell of the full array apart (arrows, dotted lines). "
        "Simulated, one realisation of phases and noise; levels below each image's own maximum. Panels and table "
        "have the share of realisations in which both were found within half of their distance."
    )
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        return out_of_sight(bench.radar, RANGE_M)

    def tasks(self, bench: Bench) -> Sequence[Task]:
        count, seed = min(bench.config.trials, MOST_REALISATIONS), bench.config.seed

        @lru_cache(maxsize=KEPT)
        def scene(index: int) -> NDArray[np.complex64]:
            return noisy_snapshot(bench.radar, _pair(bench.radar, seed, index), [seed, 10, index])

        tasks = [
            contender_task(
                bench, contender, f"realisation={index}", [seed, index, CLOSE_UP_BINS],
                partial(image_around, bench.radar, contender, partial(scene, index)),
            )
            for index in range(count)
            for contender in bench.contenders
        ]  # fmt: skip
        return [*tasks, radar_task(bench, "truth", "realisation=0", seed, partial(_truth, bench.radar, seed))]

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        count = min(bench.config.trials, MOST_REALISATIONS)
        middle, places = close_up(bench.radar, RANGE_M)[1], _places(bench.radar)
        found = []
        for contender in bench.contenders:
            cuts = np.stack(
                [
                    results[contender.method, contender.array.name, f"realisation={index}"]["image"][middle]
                    for index in range(count)
                ]
            ).astype(np.float64)
            both = resolved(strongest_peaks(cuts, bench.radar.grid.u, 2), np.tile(places, (count, 1)))
            condition = f"range={RANGE_M:g} m,separation=1 RL"
            found.append(share_row(self.name, contender, "probability of resolution", condition, both))
        return found

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        rows, middle = close_up(bench.radar, RANGE_M)
        levels = {
            (c.method, c.array.name): own_levels(results[c.method, c.array.name, "realisation=0"]["image"])
            for c in bench.contenders
        }
        truth = own_levels(results["truth", "", "realisation=0"]["image"])
        notes = {(row.method, row.array): f"resolved: {100.0 * row.value:.0f} %" for row in self.rows(bench, results)}
        marks = [(RANGE_M, float(u)) for u in _places(bench.radar)]
        figure = image_panels(
            levels, truth, bench.radar, rows[0], self.title, marks, rows[middle], reach=0.25, notes=notes
        )
        return {self.name: figure}


def _places(radar: Radar) -> NDArray[np.float64]:
    """[2] u of the cylinders, rising."""
    return CENTRE_U + resolution_cell(radar) * np.array([-0.5, 0.5])


def _pair(radar: Radar, seed: int, index: int) -> Echoes:
    """Of one realisation."""
    phase = np.random.default_rng([seed, 11, index]).uniform(-np.pi, np.pi, 2)
    return cylinders(radar, _places(radar), phase)


def _truth(radar: Radar, seed: int) -> Values:
    return truth_around(radar, _pair(radar, seed, 0))
