"""Vertical metal cylinders 5.7 m from the radar, simulated: one in many directions (the paper's Fig. 8), and two equal
ones side by side (its Fig. 10).

Each reflects from the point of its surface nearest to the radar. Its height, not published, is more than the first
Fresnel zone, sqrt(2 lambda R) = 0.21 m, and then its radar cross section no longer grows with its height: here it is a
point of 0 dBsm. The paper gives the picture of the two and not their distance; here it is one resolution cell of the
full array, lambda / (span + spacing) = 0.041 in u.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal import target_amplitudes
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import close_up, in_plane, out_of_sight, resolution_cell, snapshot, truth_image
from trainer.evaluation.experiments.bench import Bench, Numbers, Results, Simulated, Task, task_of
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.figures import image_panels
from trainer.evaluation.report.page import REPORT_SPAN_DB, own_levels
from trainer.evaluation.report.tables import TRUTH, MetricRow
from trainer.evaluation.store import Values
from trainer.metrics.peaks import point_spread, resolved, strongest_peaks

RANGE_M = 5.7
RCS_DBSM = 0.0
SHOWN_U = 0.1
ANGLES = (-0.6, -0.45, -0.3, -0.15, 0.0, SHOWN_U, 0.25, 0.4, 0.55)
"""u = sin(azimuth) of a single cylinder, one simulation each."""
WIDTH, SIDELOBE = "-3 dB width [bins]", "peak sidelobe [dB]"
CENTRE_U = 0.05
"""Of two cylinders."""
MOST_REALISATIONS = 24
"""Each is a whole image for a network of whole images."""

Echoes = tuple[NDArray[np.float64], NDArray[np.complex128]]
"""([K, 3] positions [m], [K] amplitudes [sqrt(W)])."""
Notes = dict[tuple[str, str], str]
"""Text in the panels of a figure, by (method, array)."""


class Cylinders(Simulated):
    """What contenders image around the cylinders, beside what the virtual sensor sees of one of the scenes.

    :cvar stream: of the receiver noise
    :cvar shown: place of the scene in the figure
    :cvar reach: u shown beside the cylinders
    """

    stream: int
    shown: int
    reach: float

    def obstacle(self, bench: Bench) -> str | None:
        return out_of_sight(bench.radar, RANGE_M)

    @abstractmethod
    def echoes(self, bench: Bench, place: int) -> Echoes:
        """Of a scene."""

    @abstractmethod
    def places(self, radar: Radar) -> NDArray[np.float64]:
        """[K] u of the cylinders in the figure, rising."""

    @abstractmethod
    def notes(self, rows: Sequence[MetricRow]) -> Notes:
        """What the panels say of the numbers."""

    def scene(self, bench: Bench, place: int) -> NDArray[np.complex64]:
        """[R, C] range-channel matrix with receiver noise [sqrt(W)]."""
        generator = np.random.default_rng([bench.config.seed, self.stream, place])
        return snapshot(bench.radar, *self.echoes(bench, place), generator)

    def score(self, bench: Bench, contender: Contender, place: int, scene: NDArray[np.complex64]) -> Values:
        """image [rows, U] of the range bins around the cylinders."""
        rows, _ = close_up(bench.radar, RANGE_M)
        return {"image": contender.answer.image_rows(scene, cell_noise_power(bench.radar), rows).astype(np.float32)}

    def tasks(self, bench: Bench) -> Sequence[Task]:
        shown = self.conditions(bench)[self.shown]
        return [*super().tasks(bench), task_of(bench, None, shown, self.inputs(bench), partial(self._truth, bench))]

    def _truth(self, bench: Bench) -> Values:
        rows, _ = close_up(bench.radar, RANGE_M)
        return {"image": truth_image(bench.radar, *self.echoes(bench, self.shown))[rows]}

    def cuts(self, bench: Bench, results: Results, contender: Contender) -> NDArray[np.float64]:
        """[scenes, U] the range bin of the cylinders."""
        middle = close_up(bench.radar, RANGE_M)[1]
        images = [results[*contender.key, condition]["image"] for condition in self.conditions(bench)]
        return np.stack([image[middle] for image in images]).astype(np.float64)

    def figures(self, bench: Bench, results: Results, rows: Sequence[MetricRow]) -> dict[str, Figure]:
        shown = self.conditions(bench)[self.shown]
        levels = {c.key: own_levels(results[*c.key, shown]["image"]) for c in bench.contenders}
        truth, first = own_levels(results[TRUTH, "", shown]["image"]), int(close_up(bench.radar, RANGE_M)[0][0])
        marks = [(RANGE_M, float(u)) for u in self.places(bench.radar)]
        drawn = image_panels(levels, truth, bench.radar, first, self.title, marks, self.reach, self.notes(rows))
        return {self.name: drawn}


class PointSpread(Cylinders):
    """One echo in many directions: how wide, how high the sidelobes, how far off."""

    name = "point-spread"
    title = "Point-spread function of a cylinder at 5.7 m (paper, Fig. 8)"
    caption = (
        "A metal cylinder at 5.7 m, u = 0.1, simulated by eq. (1) and (2) with receiver noise. Levels below each "
        "image's own maximum; the cut is that of the cylinder's range bin. In the table, sidelobes below -60 dB "
        "count as -60 dB; table and panels have means over nine directions."
    )
    stream, shown, reach = 8, ANGLES.index(SHOWN_U), 0.5

    def conditions(self, bench: Bench) -> Sequence[str]:
        return [f"u={u:g}" for u in ANGLES]

    def echoes(self, bench: Bench, place: int) -> Echoes:
        return _cylinders(bench.radar, np.array([ANGLES[place]]), np.zeros(1))

    def places(self, radar: Radar) -> NDArray[np.float64]:
        return np.array([SHOWN_U])

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        grid, condition = bench.radar.grid, {"range": f"{RANGE_M:g} m"}
        for contender in bench.contenders:
            spreads = [point_spread(cut, grid.u) for cut in self.cuts(bench, results, contender)]
            found_ones = [(s, u) for s, u in zip(spreads, ANGLES, strict=True) if s is not None]
            for metric, values in {
                WIDTH: [s.width / grid.step for s, _ in found_ones],
                SIDELOBE: [max(s.pslr_db, -REPORT_SPAN_DB) for s, _ in found_ones],
                "integrated sidelobes [dB]": [max(s.islr_db, -REPORT_SPAN_DB) for s, _ in found_ones],
                "angle error [bins]": [abs(s.u - u) / grid.step for s, u in found_ones],
            }.items():
                found.mean(contender, metric, condition, values)

    def notes(self, rows: Sequence[MetricRow]) -> Notes:
        numbers = {(row.method, row.array, row.metric): row.value for row in rows}
        return {
            key: f"{numbers[(*key, WIDTH)]:.1f} bins wide\nsidelobe {numbers[(*key, SIDELOBE)]:.1f} dB"
            for key in {(row.method, row.array) for row in rows}
        }


class Reflectors(Cylinders):
    """Are two equal echoes told apart?

    The figure has one realisation of phases and noise, the numbers are over many.
    """

    name = "two-reflectors"
    title = "Two cylinders, one resolution cell of the full array apart (paper, Fig. 10)"
    caption = (
        "Two equal cylinders at 5.7 m, one resolution cell of the full array apart (arrows, dotted lines). "
        "Simulated, one realisation of phases and noise; levels below each image's own maximum. Panels and table "
        "have the share of realisations in which both were found within half of their distance."
    )
    stream, shown, reach = 10, 0, 0.25

    def conditions(self, bench: Bench) -> Sequence[str]:
        return [f"realisation={index}" for index in range(min(bench.config.trials, MOST_REALISATIONS))]

    def echoes(self, bench: Bench, place: int) -> Echoes:
        phase = np.random.default_rng([bench.config.seed, 11, place]).uniform(-np.pi, np.pi, 2)
        return _cylinders(bench.radar, self.places(bench.radar), phase)

    def places(self, radar: Radar) -> NDArray[np.float64]:
        return CENTRE_U + resolution_cell(radar) * np.array([-0.5, 0.5])

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        u = bench.radar.grid.u
        condition = {"range": f"{RANGE_M:g} m", "separation": "1 RL"}
        for contender in bench.contenders:
            cuts = self.cuts(bench, results, contender)
            both = resolved(strongest_peaks(cuts, u, 2), np.tile(self.places(bench.radar), (len(cuts), 1)))
            found.share(contender, "probability of resolution", condition, both)

    def notes(self, rows: Sequence[MetricRow]) -> Notes:
        return {(row.method, row.array): f"resolved: {100.0 * row.value:.0f} %" for row in rows}


def _cylinders(radar: Radar, u: NDArray[np.float64], phase: NDArray[np.float64]) -> Echoes:
    """The echoes of cylinders at u [K] with phases [K] [rad]."""
    positions = in_plane(np.full(len(u), RANGE_M), u)
    return positions, target_amplitudes(radar, positions, np.full(len(u), RCS_DBSM), phase)
