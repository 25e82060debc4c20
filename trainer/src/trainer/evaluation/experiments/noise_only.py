"""Frames of receiver noise alone: what does a method draw where there is nothing?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.physics.errors import figure_text
from shared.signal.spectrum import range_doppler, select_doppler
from shared.signal.windows import cell_noise_power
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.figures import Look, draw_bar, panels
from trainer.evaluation.report.tables import Condition, Numbers, SummaryColumn
from trainer.evaluation.store import Values
from trainer.metrics.peaks import false_alarms, noise_level
from trainer.metrics.residual import of_one_cell
from trainer.run.imager import AMPLITUDE, PROBABILITY

FRAMES = 8
LEVEL_PROBABILITY = 1e-4
"""That delay-and-sum of noise exceeds the level at any one angle, in any Doppler cell of a range bin."""
HALF = 0.5
METRIC = "false alarms a noise-only frame"


class NoiseOnly(Experiment):
    """Is anything invented?"""

    name = "noise-only"
    title = "False alarms in frames of noise alone"
    caption = (
        "Peaks in frames of receiver noise without any target, the strongest Doppler cell of every range bin, as "
        "datasets hold it: of images in sqrt(W) above the level that delay-and-sum of the same array exceeds with a "
        "probability of 1e-4 at each angle in any Doppler cell, of probabilities above 0.5. Images relative to their "
        "own peak have no level and are left out. Bars: 95 % intervals."
    )
    summary = (SummaryColumn("false alarms", METRIC, digits=1),)
    metrics = (METRIC,)

    def obstacle(self, bench: Bench) -> str | None:
        return None if self.entrants(bench) else "every image is relative to its own peak"

    def conditions(self, bench: Bench) -> Sequence[Condition]:
        return [{"frame": index} for index in range(min(FRAMES, bench.config.trials))]

    def entrants(self, bench: Bench) -> tuple[Contender, ...]:
        """The contenders whose images have an absolute level."""
        return tuple(one for one in bench.contenders if one.answer.unit in (AMPLITUDE, PROBABILITY))

    def scene(self, bench: Bench, place: int) -> NDArray[np.complex64]:
        radar, waveform = bench.radar, bench.radar.waveform
        shape = (waveform.chirps, waveform.samples, radar.array.channels, 2)
        drawn = np.random.default_rng([bench.config.seed, 40, place]).standard_normal(shape, dtype=np.float32)
        cube = np.float32(np.sqrt(0.5 * radar.sample_noise_power_w)) * drawn.view(np.complex64)[..., 0]
        return select_doppler(range_doppler(cube, radar), cell_noise_power(radar), peaks=1).range_channel[0]

    def score(self, bench: Bench, contender: Contender, place: int, scene: NDArray[np.complex64]) -> Values:
        noise = cell_noise_power(bench.radar)
        amplitudes = contender.answer.unit == AMPLITUDE
        of_a_cell = of_one_cell(LEVEL_PROBABILITY, bench.radar.waveform.chirps)
        level = noise_level(contender.answer.line, noise, of_a_cell) if amplitudes else HALF
        return {METRIC: np.asarray(false_alarms(contender.answer.image(scene, noise), level))}

    def pooled(self, contender: Contender) -> Condition:
        return {"level": f"{LEVEL_PROBABILITY:g} of das" if contender.answer.unit == AMPLITUDE else f"{HALF:g}"}

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        contenders = self.entrants(bench)
        look = Look(one.key for one in contenders)
        figure, ((axis,),) = panels(1, 1, (max(5.0, 0.5 * len(contenders) + 1.5), 3.6), self.title)
        for place, row in enumerate(found.rows):
            draw_bar(axis, place, row, color=look.colour(row.method))
        axis.set_xticks(range(len(contenders)), [figure_text(c.name) for c in contenders], rotation=60, ha="right")
        axis.set_ylabel(METRIC)
        axis.grid(axis="y", alpha=0.25)
        return {self.name: figure}
