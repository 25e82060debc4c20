"""Point-spread function of a cylinder at 5.7 m (the paper's Fig. 8), simulated.

The figure has it at u = 0.1; the numbers are means over :data:`ANGLES`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.data.simulation import CLOSE_UP_BINS, close_up, out_of_sight
from trainer.evaluation.experiments.bench import (
    KEPT,
    Bench,
    Results,
    Task,
    contender_task,
    mean_row,
    radar_task,
)
from trainer.evaluation.experiments.cylinders import (
    RANGE_M,
    Echoes,
    cylinders,
    image_around,
    noisy_snapshot,
    truth_around,
)
from trainer.evaluation.report.levels import REPORT_SPAN_DB, own_levels
from trainer.evaluation.report.panels import image_panels
from trainer.evaluation.rows import MetricRow, SummaryColumn
from trainer.evaluation.store import Values
from trainer.metrics.peaks import point_spread

SHOWN_U = 0.1
ANGLES = (-0.6, -0.45, -0.3, -0.15, 0.0, SHOWN_U, 0.25, 0.4, 0.55)
"""u = sin(azimuth) of the cylinder, one simulation each."""
WIDTH, SIDELOBE = "-3 dB width [bins]", "peak sidelobe [dB]"


class CylinderSpread:
    """One echo in many directions: how wide, how high the sidelobes, how far off."""

    name = "point-spread"
    cells = name
    title = "Point-spread function of a cylinder at 5.7 m (paper, Fig. 8)"
    caption = (
        "A metal cylinder at 5.7 m, u = 0.1, simulated by eq. (1) and (2) with receiver noise. Levels below each "
        "image's own maximum; the cut is that of the cylinder's range bin. In the table, sidelobes below -60 dB "
        "count as -60 dB; table and panels have means over nine directions."
    )
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        return out_of_sight(bench.radar, RANGE_M)

    def tasks(self, bench: Bench) -> Sequence[Task]:
        seed = bench.config.seed

        @lru_cache(maxsize=KEPT)
        def scene(index: int) -> NDArray[np.complex64]:
            return noisy_snapshot(bench.radar, _cylinder(bench.radar, ANGLES[index]), [seed, 8, index])

        tasks = [
            contender_task(
                bench, contender, f"u={u:g}", [seed, index, CLOSE_UP_BINS],
                partial(image_around, bench.radar, contender, partial(scene, index)),
            )
            for index, u in enumerate(ANGLES)
            for contender in bench.contenders
        ]  # fmt: skip
        return [*tasks, radar_task(bench, "truth", f"u={SHOWN_U:g}", CLOSE_UP_BINS, partial(_truth, bench.radar))]

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        found = []
        middle, grid = close_up(bench.radar, RANGE_M)[1], bench.radar.grid
        for contender in bench.contenders:
            cuts = [
                results[contender.method, contender.array.name, f"u={u:g}"]["image"][middle].astype(np.float64)
                for u in ANGLES
            ]
            spreads = [(point_spread(cut, grid.u), u) for cut, u in zip(cuts, ANGLES, strict=True)]
            found_ones = [(s, u) for s, u in spreads if s is not None]
            for metric, values in {
                WIDTH: [s.width / grid.step for s, _ in found_ones],
                SIDELOBE: [max(s.pslr_db, -REPORT_SPAN_DB) for s, _ in found_ones],
                "integrated sidelobes [dB]": [max(s.islr_db, -REPORT_SPAN_DB) for s, _ in found_ones],
                "angle error [bins]": [abs(s.u - u) / grid.step for s, u in found_ones],
            }.items():
                found.append(mean_row(bench, self.name, contender, metric, f"range={RANGE_M:g} m", values))
        return found

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        rows, middle = close_up(bench.radar, RANGE_M)
        shown = f"u={SHOWN_U:g}"
        levels = {
            (c.method, c.array.name): own_levels(results[c.method, c.array.name, shown]["image"])
            for c in bench.contenders
        }
        truth = own_levels(results["truth", "", shown]["image"])
        numbers = {(row.method, row.array, row.metric): row.value for row in self.rows(bench, results)}
        notes = {
            key: f"{numbers[(*key, WIDTH)]:.1f} bins wide\nsidelobe {numbers[(*key, SIDELOBE)]:.1f} dB"
            for key in levels
        }
        figure = image_panels(
            levels, truth, bench.radar, rows[0], self.title, [(RANGE_M, SHOWN_U)], rows[middle], reach=0.5, notes=notes
        )
        return {self.name: figure}


def _cylinder(radar: Radar, u: float) -> Echoes:
    return cylinders(radar, np.array([u]), np.zeros(1))


def _truth(radar: Radar) -> Values:
    return truth_around(radar, _cylinder(radar, SHOWN_U))
