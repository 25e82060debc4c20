"""Resolution against the physical limit: the Cramer-Rao bound of one target, maximum likelihood of two.

Maximum likelihood knows that there are two targets and is the ceiling: whoever clearly beats it leaks, has a stronger
prior or is helped by neighbouring range bins. It is computed on every array, whether it is among the methods or not.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from shared.physics.errors import figure_text
from trainer.data.simulation import TrialCondition, Trials, no_room, simulate
from trainer.estimators.ml import MaximumLikelihood
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import Contender, estimator_contender
from trainer.evaluation.report.figures import Look, legend_below, panels
from trainer.evaluation.report.tables import PROBABILITY_OF_RESOLUTION, Numbers, SummaryColumn, condition_text
from trainer.evaluation.store import Values
from trainer.metrics.peaks import point_spread, resolved, single_source_bound, strongest_peaks

SEPARATIONS = (1.0, 0.75, 0.5, 0.25)
SNRS_DB = (10.0, 20.0, 30.0)
RATIOS_DB = (0.0, 10.0)
SINGLE_SNRS_DB = (0.0, 5.0, 10.0, 20.0, 30.0, 40.0)
SHOWN_SNR_DB = 20.0
PHASE_GROUPS_DEG = ((0, 60), (60, 120), (120, 180))
"""Of the second target against the first at the middle of the array, without sign."""

PAIRS = tuple(TrialCondition(*values) for values in product(SEPARATIONS, SNRS_DB, RATIOS_DB))
SINGLES = tuple(TrialCondition(0.0, snr) for snr in SINGLE_SNRS_DB)
CEILING = "ml"
LINES = ", lines"
"""After the name of a method whose peaks begin a fit of lines."""
ERROR_OVER_BOUND = "RMSE over bound"


class Resolution(Experiment):
    """How close may two targets be, and how well is one placed?"""

    name = "resolution"
    title = "Resolution against maximum likelihood, accuracy against the Cramer-Rao bound"
    caption = (
        "Upper line: share of pairs of equal targets of random phase of which both were found within half of their "
        "distance, over that distance in cells of the full array (RL), at 20 dB in each channel. ml knows that there "
        "are two. Where a method's name ends in lines, its peaks begin a joint fit that is told no number. Lower line: "
        "root-mean-square error of a single target over the root of the array's Cramer-Rao bound; 1 is efficient. "
        "Peaks are interpolated, but a peak narrower than two bins is placed no better than its bin, one wild peak in "
        "a hundred costs far more than the bound, and at 40 dB the front's curvature at 12 m costs all as much as the "
        "noise."
    )
    summary = (  # of pairs of equal targets
        SummaryColumn("P(resolve) 1 RL", PROBABILITY_OF_RESOLUTION, TrialCondition(1.0, SHOWN_SNR_DB).named),
        SummaryColumn("0.5 RL", PROBABILITY_OF_RESOLUTION, TrialCondition(0.5, SHOWN_SNR_DB).named),
    )

    def obstacle(self, bench: Bench) -> str | None:
        return no_room(bench.radar, max(SEPARATIONS))

    def conditions(self, bench: Bench) -> list[dict[str, str]]:
        return [condition.named for condition in (*PAIRS, *SINGLES)]

    def entrants(self, bench: Bench) -> tuple[Contender, ...]:
        """The contenders, those with a fit of lines once more with it, and maximum likelihood on each of the arrays."""
        others = tuple(contender for contender in bench.contenders if contender.method != CEILING)
        fitted = tuple(replace(contender, method=contender.method + LINES) for contender in others if contender.fits)
        return (*others, *fitted, *(estimator_contender(CEILING, array, bench.radar) for array in bench.arrays))

    def inputs(self, bench: Bench) -> list[int]:
        return [bench.config.seed, bench.config.trials]

    def scene(self, bench: Bench, place: int) -> Trials:
        config = bench.config
        return simulate(bench.radar, (*PAIRS, *SINGLES)[place], config.trials, [config.seed, 20, place])

    def score(self, bench: Bench, contender: Contender, place: int, scene: Trials) -> Values:
        return locate_targets(contender, scene)

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        for contender in self.entrants(bench):
            for condition in PAIRS:
                values = results[*contender.key, condition_text(condition.named)]
                both = resolved(values["found"], values["u"])
                found.mean(contender.key, PROBABILITY_OF_RESOLUTION, condition.named, both)
                degrees = np.abs(np.rad2deg(values["phase_rad"]))
                for low, high in PHASE_GROUPS_DEG:
                    group = (degrees >= low) & (degrees <= high)
                    if group.any():
                        of = {**condition.named, "phase": f"{low}-{high} deg"}
                        found.mean(contender.key, PROBABILITY_OF_RESOLUTION, of, both[group])
            for condition in SINGLES:
                values, named = results[*contender.key, condition_text(condition.named)], condition.named
                errors = (values["found"] - values["u"])[:, 0]  # NaN where none was found
                bound = single_source_bound(contender.answer.line, 10.0 ** (condition.snr_db / 10.0))
                found.mean(contender.key, "bias [bins]", named, errors / bench.radar.grid.step)
                found.mean(contender.key, ERROR_OVER_BOUND, named, errors**2 / bound, root=True)

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        contenders = self.entrants(bench)
        look = Look(one.key for one in contenders)
        size = 3.4 * len(look.arrays) + 0.6, 6.6
        figure, axes = panels(2, len(look.arrays), size, self.title, sharey="row")
        for contender in contenders:
            column = look.arrays.index(contender.array.name)
            ceiling = contender.method == CEILING
            style = {
                "color": "black" if ceiling else look.colour(contender.method), "marker": "o", "ms": 3.5,
                "lw": 1.3 if ceiling else look.weight(contender.method), "ls": "--" if ceiling else "-",
            }  # fmt: skip
            pairs = [TrialCondition(separation, SHOWN_SNR_DB).named for separation in SEPARATIONS]
            axes[0, column].plot(SEPARATIONS, found.values(contender.key, PROBABILITY_OF_RESOLUTION, pairs), **style)
            singles = [single.named for single in SINGLES]
            axes[1, column].plot(SINGLE_SNRS_DB, found.values(contender.key, ERROR_OVER_BOUND, singles), **style)
        for column, array in enumerate(look.arrays):
            axes[0, column].set(
                title=f"{figure_text(array)}: two targets, 20 dB", xlabel="separation [RL]", ylim=(-0.03, 1.03)
            )
            axes[1, column].set(title=f"{figure_text(array)}: one target", xlabel="SNR of a channel [dB]", yscale="log")
            axes[1, column].axhline(1.0, color="grey", lw=0.8)
        axes[0, 0].set_ylabel("probability of resolution")
        axes[1, 0].set_ylabel("RMSE / root of the bound")
        for axis in axes.ravel():
            axis.grid(alpha=0.25)
        others = [handle for handle in look.method_handles() if handle.get_label() != CEILING]
        known = Line2D([], [], color="black", ls="--", lw=2.0, label="ml, the number of targets known")
        legend_below(figure, [*others, known])
        return {self.name: figure}


def locate_targets(contender: Contender, trials: Trials) -> Values:
    """found [T, K] angles of the targets of each trial, rising, NaN where there are fewer; u [T, K] the true ones;
    phase_rad [T] of the trials."""
    targets, u = trials.u.shape[1], contender.answer.radar.grid.u
    if contender.method == CEILING:
        snapshots = trials.snapshots[:, trials.rows][..., contender.answer.channels]
        flat = snapshots.reshape(-1, snapshots.shape[-1])
        found = MaximumLikelihood(targets).locate(flat, contender.answer.line)[0]
    elif contender.method.endswith(LINES):
        found = contender.locate(trials)
    elif targets == 1:
        spreads = [point_spread(image, u) for image in contender.of_trials(trials)[0]]
        found = np.array([[math.nan if spread is None else spread.u] for spread in spreads])
    else:
        found = strongest_peaks(contender.of_trials(trials)[1], u, targets)
    return {"found": found, "u": trials.u, "phase_rad": trials.phase_rad}
