"""Vertical metal cylinders 5.7 m from the radar, simulated: one in many directions (the paper's Fig. 8), and two equal
ones side by side (its Fig. 10).

Each reflects from the point of its surface nearest to the radar. Its height, not published, is more than the first
Fresnel zone, sqrt(2 lambda R) = 0.21 m, and then its radar cross section no longer grows with its height: here it is a
point of 0 dBsm. The paper gives the picture of the two and not their distance; here it is one resolution cell of the
full array, lambda / (span + spacing) = 0.041 in u.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal import target_amplitudes
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import close_up, in_plane, out_of_sight, snapshot, truth_image
from trainer.estimators.array import line_array
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.figures import image_panels
from trainer.evaluation.report.page import REPORT_SPAN_DB, own_levels
from trainer.evaluation.report.tables import PROBABILITY_OF_RESOLUTION, TRUTH, Condition, Numbers, condition_text
from trainer.evaluation.store import Values
from trainer.metrics.peaks import point_spread, resolved, strongest_peaks

RANGE_M = 5.7
RCS_DBSM = 0.0
AT_RANGE: Condition = {"range": f"{RANGE_M:g} m"}
PAIR: Condition = {**AT_RANGE, "separation": "1 RL"}
"""What the numbers of one cylinder and of two are of."""
SHOWN_U = 0.1
ANGLES = (-0.6, -0.45, -0.3, -0.15, 0.0, SHOWN_U, 0.25, 0.4, 0.55)
"""u = sin(azimuth) of a single cylinder, one simulation each."""
WIDTH, SIDELOBE = "-3 dB width [bins]", "peak sidelobe [dB]"
CENTRE_U = 0.05
"""Of two cylinders."""
MOST_REALISATIONS = 24
"""Each is a whole image for a network of whole images."""


class Cylinders(Experiment, ABC):
    """What contenders image around the cylinders, beside what the virtual sensor sees of one of the scenes.

    :cvar of_all: the condition of the numbers, which are over all scenes
    :cvar stream: of the receiver noise
    :cvar shown: place of the scene in the figure
    :cvar reach: u shown beside the cylinders
    """

    of_all: Condition
    stream: int
    shown: int
    reach: float

    def obstacle(self, bench: Bench) -> str | None:
        return out_of_sight(bench.radar, RANGE_M)

    @abstractmethod
    def places(self, radar: Radar, place: int) -> NDArray[np.float64]:
        """[K] u of the cylinders of a scene, rising."""

    @abstractmethod
    def judged(self, radar: Radar, true: NDArray[np.float64], cut: NDArray[np.float64]) -> Values:
        """The figures of a scene by the range bin [U] of its cylinders, which truly stand at these u."""

    @abstractmethod
    def note(self, found: Numbers, key: tuple[str, str]) -> str:
        """What the panel of a (method, array) says of its numbers."""

    def pooled(self, contender: Contender) -> Condition:
        return self.of_all

    def echoes(self, bench: Bench, place: int) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """([K, 3] positions [m], [K] amplitudes [sqrt(W)]) of a scene. The phase of one echo alone plays no part."""
        u = self.places(bench.radar, place)
        positions, phase = in_plane(np.full(len(u), RANGE_M), u), np.zeros(1)
        if len(u) > 1:
            phase = np.random.default_rng([bench.config.seed, 11, place]).uniform(-np.pi, np.pi, len(u))
        return positions, target_amplitudes(bench.radar, positions, np.full(len(u), RCS_DBSM), phase)

    def scene(self, bench: Bench, place: int) -> NDArray[np.complex64]:
        """[R, C] range-channel matrix with receiver noise [sqrt(W)]."""
        generator = np.random.default_rng([bench.config.seed, self.stream, place])
        return snapshot(bench.radar, *self.echoes(bench, place), generator)

    def score(self, bench: Bench, contender: Contender, place: int, scene: NDArray[np.complex64]) -> Values:
        """image [rows, U] of the range bins around the cylinders; the figures of :meth:`judged`."""
        rows, middle = close_up(bench.radar, RANGE_M)
        seen, _ = contender.answer.of_rows(scene, cell_noise_power(bench.radar), rows)
        image = seen.astype(np.float32)
        true = self.places(bench.radar, place)
        return {"image": image, **self.judged(bench.radar, true, image[middle].astype(np.float64))}

    def truths(self, bench: Bench, place: int) -> Mapping[str, Callable[[object], Values]]:
        if place != self.shown:
            return {}
        rows, _ = close_up(bench.radar, RANGE_M)
        return {"": lambda _: {"image": truth_image(bench.radar, *self.echoes(bench, place))[rows]}}

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        shown = condition_text(self.conditions(bench)[self.shown])
        levels = {c.key: own_levels(results[*c.key, shown]["image"]) for c in bench.contenders}
        truth, first = own_levels(results[TRUTH, "", shown]["image"]), int(close_up(bench.radar, RANGE_M)[0][0])
        marks = [(RANGE_M, float(u)) for u in self.places(bench.radar, self.shown)]
        notes = {key: self.note(found, key) for key in levels}
        return {self.name: image_panels(levels, truth, bench.radar, first, self.title, marks, self.reach, notes)}


class PointSpread(Cylinders):
    """One echo in many directions: how wide, how high the sidelobes, how far off."""

    name = "point-spread"
    title = "Point-spread function of a cylinder at 5.7 m (paper, Fig. 8)"
    caption = (
        "A metal cylinder at 5.7 m, u = 0.1, simulated by eq. (1) and (2) with receiver noise. Levels below each "
        "image's own maximum; the cut is that of the cylinder's range bin. In the table, sidelobes below -60 dB "
        "count as -60 dB; table and panels have means over nine directions."
    )
    metrics = (WIDTH, SIDELOBE, "integrated sidelobes [dB]", "angle error [bins]")
    of_all, stream, shown, reach = AT_RANGE, 8, ANGLES.index(SHOWN_U), 0.5

    def conditions(self, bench: Bench) -> Sequence[Condition]:
        return [{"u": f"{u:g}"} for u in ANGLES]

    def places(self, radar: Radar, place: int) -> NDArray[np.float64]:
        return np.array([ANGLES[place]])

    def judged(self, radar: Radar, true: NDArray[np.float64], cut: NDArray[np.float64]) -> Values:
        """NaN of an empty cut."""
        found, step = point_spread(cut, radar.grid.u), radar.grid.step
        numbers = [math.nan] * len(self.metrics)
        if found is not None:
            sidelobes = (max(level, -REPORT_SPAN_DB) for level in (found.pslr_db, found.islr_db))
            numbers = [found.width / step, *sidelobes, abs(found.u - true[0]) / step]
        return {metric: np.asarray(number) for metric, number in zip(self.metrics, numbers, strict=True)}

    def note(self, found: Numbers, key: tuple[str, str]) -> str:
        width, sidelobe = (found.row(key, metric, self.of_all).value for metric in (WIDTH, SIDELOBE))
        return f"{width:.1f} bins wide\nsidelobe {sidelobe:.1f} dB"


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
    metrics = (PROBABILITY_OF_RESOLUTION,)
    of_all, stream, shown, reach = PAIR, 10, 0, 0.25

    def conditions(self, bench: Bench) -> Sequence[Condition]:
        return [{"realisation": index} for index in range(min(bench.config.trials, MOST_REALISATIONS))]

    def places(self, radar: Radar, place: int) -> NDArray[np.float64]:
        return CENTRE_U + line_array(radar).resolution_cell * np.array([-0.5, 0.5])

    def judged(self, radar: Radar, true: NDArray[np.float64], cut: NDArray[np.float64]) -> Values:
        return {PROBABILITY_OF_RESOLUTION: resolved(strongest_peaks(cut[None], radar.grid.u, 2), true[None])}

    def note(self, found: Numbers, key: tuple[str, str]) -> str:
        return f"resolved: {100.0 * found.row(key, PROBABILITY_OF_RESOLUTION, self.of_all).value:.0f} %"
