"""Average precision, its gain, and detection probability over false alarms: rows of the table and a figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from shared.physics.errors import figure_text
from trainer.evaluation.experiments.bench import Bench, FrameRef, Results
from trainer.evaluation.experiments.contenders import look_of
from trainer.evaluation.experiments.frames import ranking
from trainer.evaluation.report.style import TRUTH_COLOUR, counted, label_ends, new_figure, subplots
from trainer.evaluation.rows import AVERAGE_PRECISION, TRUTH, Condition, MetricRow
from trainer.metrics.ranking import mean_average_precision

DETECTION_PROBABILITY = "detection probability"
OVER_NEXT = "average precision less that of the best other method"
"""Of a network, paired over the frames."""
FALSE_ALARMS = (1, 10, 100)
"""A frame, at which the table has the detection probability."""
SHOWN_FALSE_ALARMS = (0.1, 1000.0)
"""A frame, from and to, in the figure."""
TITLE = "Detection probability over false alarms"


def at_false_alarms(count: int) -> dict[str, object]:
    """The condition of a row of :data:`DETECTION_PROBABILITY`."""
    return {"false alarms": f"{count} a frame"}


def ranking_rows(
    bench: Bench,
    experiment: str,
    results: Results,
    method: str,
    array: str,
    refs: Sequence[FrameRef],
    condition: Condition,
) -> list[MetricRow]:
    """Average precision and detection probabilities of a method, or of the truth itself, over frames."""
    metrics = [(AVERAGE_PRECISION, condition)]
    metrics += [(DETECTION_PROBABILITY, {**condition, **at_false_alarms(count)}) for count in FALSE_ALARMS]
    found = ranking(results, method, array, refs).intervals(FALSE_ALARMS, bench.config.seed)
    return [
        MetricRow(experiment, method, array, metric, of, one.value, one.low, one.high, len(refs))
        for (metric, of), one in zip(metrics, found, strict=True)
    ]


def gain_rows(bench: Bench, experiment: str, results: Results, refs: Sequence[FrameRef]) -> list[MetricRow]:
    """What each network's average precision has over the best of the other methods of its array, on the same frames.

    Frames are drawn for both at once (:func:`trainer.metrics.ranking.mean_average_precision`). The condition names the
    other method.
    """
    found = []
    for array in bench.arrays:
        contenders = [contender for contender in bench.contenders if contender.array.name == array.name]
        rankings = {one.method: ranking(results, one.method, array.name, refs) for one in contenders}
        precision = {method: one.average_precision() for method, one in rankings.items()}
        for network in contenders:
            others = [method for method in precision if method != network.method]
            if not network.parameters or not others:
                continue
            best = max(others, key=precision.__getitem__)
            gain = mean_average_precision([rankings[network.method]], [rankings[best]], bench.config.seed)
            found.append(
                MetricRow(
                    experiment, network.method, array.name, OVER_NEXT, {"over": best},
                    gain.value, gain.low, gain.high, len(refs),
                )
            )  # fmt: skip
    return found


def ranking_figure(bench: Bench, results: Results, refs: Sequence[FrameRef]) -> Figure:
    """Detection probability over false alarms a frame, a panel for each array."""
    look = look_of(bench.contenders)
    figure = new_figure(4.4 * len(look.arrays) + 0.6, 4.6, f"{TITLE}: {counted(len(refs), 'frame')}")
    axes = subplots(figure, 1, len(look.arrays), sharey=True)[0]
    least, most = SHOWN_FALSE_ALARMS
    places = np.geomspace(least, most, 241)
    for axis, array in zip(axes, look.arrays, strict=True):
        methods = [contender.method for contender in bench.contenders if contender.array.name == array]
        ends = []
        for method in (*methods, TRUTH):
            false, detected = ranking(results, method, array, refs).curve()
            down_to = np.searchsorted(false, places, side="right")
            shown = np.concatenate([[0.0], detected])[down_to]
            colour = TRUTH_COLOUR if method == TRUTH else look.colour(method)
            width = 1.3 if method == TRUTH else look.weight(method)
            # Behind its last false alarm a method has nothing more to offer. The truth has none.
            solid = (places <= false.max(initial=0.0)) | (method == TRUTH)
            axis.plot(places[solid], shown[solid], color=colour, lw=width)
            axis.plot(places[~solid], shown[~solid], color=colour, lw=1.0, ls=":")
            ends.append((float(shown[-1]), method, colour))
        axis.set(title=figure_text(array), xlabel="false alarms a frame", xscale="log", xlim=(least, most))
        axis.set_ylim(0.0, 1.03)
        axis.grid(alpha=0.25)
        label_ends(axis, ends)
    axes[0].set_ylabel("detection probability")
    return figure
