"""What a sensor that is not the ideal one costs: gain and phase errors, dead elements, displaced elements, noise.

Pairs of equal targets one resolution cell of the full array apart, at 20 dB in each channel; every pair is seen by
another sensor, i.e. has errors of its own, and no method is told of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.physics.units import db_to_amplitude
from shared.radar.arrays import AntennaArray
from trainer.data.arrays import ArrayChoice
from trainer.data.simulation import TrialCondition, Trials, no_room, simulate, trial_rows
from trainer.estimators.array import line_array
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.figures import Look, legend_below, panels
from trainer.evaluation.report.tables import PROBABILITY_OF_RESOLUTION, Numbers
from trainer.evaluation.store import Values
from trainer.metrics.detection import find_image_peaks
from trainer.metrics.peaks import resolved, strongest_peaks

SEPARATION_CELLS = 1.0
SNR_DB = 20.0


@dataclass(frozen=True)
class Impairment:
    """One departure from the ideal sensor.

    :param kind: "gain error", "phase error", "dead RX", "RX position error" or "SNR"
    :param size: standard deviation [dB, deg, mm], number of RX, or SNR [dB]
    """

    kind: str
    size: float

    @property
    def named(self) -> dict[str, str]:
        return {self.kind: f"{self.size:g} {UNITS[self.kind]}".strip()}


UNITS = {"gain error": "dB", "phase error": "deg", "dead RX": "", "RX position error": "mm", "SNR": "dB"}
SIZES: Mapping[str, Sequence[float]] = {
    "gain error": (0.0, 1.0, 2.0, 4.0),
    "phase error": (0.0, 5.0, 10.0, 20.0, 40.0),
    "dead RX": (0.0, 1.0, 2.0),
    "RX position error": (0.0, 0.1, 0.2, 0.4, 0.8),
    "SNR": (0.0, 10.0, SNR_DB, 30.0),
}
IDEAL = Impairment("SNR", SNR_DB)
METRICS = (PROBABILITY_OF_RESOLUTION, "false peaks a trial")


def swept(kind: str) -> list[Impairment]:
    """Of one kind. Where there is no error it is the ideal sensor, which is the same cell for all kinds."""
    return [IDEAL if kind != "SNR" and size == 0 else Impairment(kind, size) for size in SIZES[kind]]


def impairments() -> list[Impairment]:
    """All, the ideal sensor first and once."""
    return list(dict.fromkeys([IDEAL, *(one for kind in SIZES for one in swept(kind))]))


def displaced(array: AntennaArray, deviation_mm: float, generator: np.random.Generator) -> AntennaArray:
    """The array with its RX elements moved along y by normal errors [mm]."""
    moved = array.rx + np.array([0.0, 1e-3 * deviation_mm, 0.0]) * generator.standard_normal((len(array.rx_m), 1))
    return array.model_copy(update={"rx_m": tuple(tuple(float(x) for x in position) for position in moved)})


def channel_factors(
    impairment: Impairment, array: AntennaArray, chosen: ArrayChoice, generator: np.random.Generator
) -> NDArray[np.complex128]:
    """[C] what each of the radar's channels is multiplied by.

    Gain and phase errors are of the channels. Dead elements are drawn among those of the chosen array.
    """
    factors = np.ones(array.channels, dtype=np.complex128)
    errors = generator.standard_normal(array.channels)
    if impairment.kind == "gain error":
        return factors * db_to_amplitude(impairment.size * errors)
    if impairment.kind == "phase error":
        return factors * np.exp(1j * np.deg2rad(impairment.size) * errors)
    if impairment.kind == "dead RX":
        dead = generator.permutation(chosen.rx)[: int(impairment.size)]
        factors[array.channel_indices(tuple(int(rx) for rx in dead))] = 0.0
    return factors


class Robustness(Experiment):
    """Who depends on a calibrated sensor?"""

    name = "robustness"
    title = "Robustness to errors of the sensor"
    caption = (
        "Two equal targets one resolution cell of the full array apart, random phase, 20 dB in each channel unless "
        "stated. Upper line: share of pairs found. Lower line: peaks above half of the maximum that belong to no "
        "target."
    )
    metrics = METRICS

    def obstacle(self, bench: Bench) -> str | None:
        return no_room(bench.radar, SEPARATION_CELLS)

    def conditions(self, bench: Bench) -> list[dict[str, str]]:
        return [impairment.named for impairment in impairments()]

    def inputs(self, bench: Bench) -> list[int]:
        return [bench.config.seed, bench.config.trials]

    def scene(self, bench: Bench, place: int) -> list[Trials]:
        """Images, each of as many trials as it has room for; the same targets and noise whatever the impairment."""
        impairment, radar, seed = impairments()[place], bench.radar, bench.config.seed
        condition = TrialCondition(SEPARATION_CELLS, impairment.size if impairment.kind == "SNR" else SNR_DB)
        count = len(trial_rows(radar))
        images = []
        for image in range(-(-bench.config.trials // count)):
            arrays = None
            if impairment.kind == "RX position error":
                generator = np.random.default_rng([seed, 31, image])
                arrays = [displaced(radar.array, impairment.size, generator) for _ in range(count)]
            images.append(simulate(radar, condition, 1, [seed, 30, image], arrays))
        return images

    def score(self, bench: Bench, contender: Contender, place: int, scene: list[Trials]) -> Values:
        """[trials] of each of :data:`METRICS`."""
        radar, both, extra = bench.radar, [], []
        reach = 0.5 * SEPARATION_CELLS * line_array(radar).resolution_cell
        for image, trials in enumerate(scene):
            generator, rows = np.random.default_rng([bench.config.seed, 32, image]), trials.rows
            drawn = [channel_factors(impairments()[place], radar.array, contender.array, generator) for _ in rows]
            # The range bins between two pairs have the sensor of the nearer pair.
            nearest = np.abs(np.arange(radar.waveform.range_bins)[:, None] - rows).argmin(axis=1)
            seen = replace(trials, snapshots=(trials.snapshots * np.stack(drawn)[nearest]).astype(np.complex64))
            images = contender.of_trials(seen)[0]
            both.append(resolved(strongest_peaks(images, radar.grid.u, 2), trials.u))
            extra.append(false_peaks(images, radar.grid.u, trials.u, reach))
        return {METRICS[0]: np.concatenate(both), METRICS[1]: np.concatenate(extra)}

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        look = Look(one.key for one in bench.contenders)
        figure, axes = panels(len(METRICS), len(SIZES), (13.0, 5.4), self.title, sharey="row", sharex="col")
        for column, (kind, sizes) in enumerate(SIZES.items()):
            unit = f" [{UNITS[kind]}]" if UNITS[kind] else ""
            axes[-1, column].set_xlabel(f"{kind}{unit}")
            for line, metric in enumerate(METRICS):
                axis = axes[line, column]
                axis.grid(alpha=0.25)
                for contender in bench.contenders:
                    means = found.values(contender.key, metric, [one.named for one in swept(kind)])
                    axis.plot(
                        sizes, means, color=look.colour(contender.method), ls=look.line(contender.array.name),
                        marker=look.marker(contender.array.name), ms=3.5, lw=look.weight(contender.method),
                    )  # fmt: skip
        for line, metric in enumerate(METRICS):
            axes[line, 0].set_ylabel(metric)
        axes[0, 0].set_ylim(-0.03, 1.03)
        # The scale is linear below one, so that zero has a place.
        axes[1, 0].set_yscale("symlog", linthresh=1.0)
        axes[1, 0].set_ylim(bottom=-0.03)
        legend_below(figure, [*look.method_handles(), *look.array_handles()])
        return {self.name: figure}


def false_peaks(
    images: NDArray[np.floating], u: NDArray[np.float64], true: NDArray[np.float64], reach: float
) -> NDArray[np.int64]:
    """[T] peaks of each row above half of its maximum that are farther than ``reach`` from every true angle [T, K]."""
    peaks = find_image_peaks(images)
    far = np.all(np.abs(u[peaks.bins][:, None] - true[peaks.rows]) > reach, axis=1)
    return np.bincount(peaks.rows[far], minlength=len(images))
