"""Detection, false alarm and precision on unseen scene frames (the paper's Fig. 11), and the strict scores beside
them."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.figure import Figure

from shared.physics.errors import figure_text
from trainer.evaluation.experiments.bench import Bench, Results
from trainer.evaluation.experiments.frames import RESIDUAL, FrameScores, OfFrames
from trainer.evaluation.report.figures import TRUTH_COLOUR, Look, counted, label_ends, legend_below, panels
from trainer.evaluation.report.tables import AVERAGE_PRECISION, TRUTH, Condition, Numbers, SummaryColumn
from trainer.metrics.cells import average_precision
from trainer.metrics.detection import D_MAX_BINS, PROMINENCES

DETECTION_PROBABILITY = "detection probability"
OVER_NEXT = "average precision less that of the best other method"
"""Of a network, paired over the frames."""
FALSE_ALARMS = (1, 10, 100)
"""A frame, at which the table has the detection probability."""
SHOWN_FALSE_ALARMS = (0.1, 1000.0)
"""A frame, from and to, in the figure."""


def at_false_alarms(count: int) -> dict[str, object]:
    """The condition of a row of :data:`DETECTION_PROBABILITY`."""
    return {"false alarms": f"{count} a frame"}


def count_ranking(scores: FrameScores, key: tuple[str, str], condition: Condition, found: Numbers) -> None:
    """Average precision and detection probabilities of a (method, array), or of the truth itself, over frames."""
    metrics = [(AVERAGE_PRECISION, condition)]
    metrics += [(DETECTION_PROBABILITY, {**condition, **at_false_alarms(count)}) for count in FALSE_ALARMS]
    intervals = scores.ranking(key).intervals(FALSE_ALARMS, found.seed)
    for (metric, of), one in zip(metrics, intervals, strict=True):
        found.add(key, metric, of, one, len(scores.refs))


def count_gains(bench: Bench, scores: FrameScores, found: Numbers) -> None:
    """What each network's average precision has over the best of the other methods of its array, on the same frames.

    Frames are drawn for both at once (:func:`trainer.metrics.cells.average_precision`). The condition names the
    other method.
    """
    for array in bench.arrays:
        contenders = [contender for contender in bench.contenders if contender.array.name == array.name]
        rankings = {one.method: scores.ranking(one.key) for one in contenders}
        precision = {method: one.average_precision() for method, one in rankings.items()}
        for network in contenders:
            others = [method for method in precision if method != network.method]
            if not network.parameters or not others:
                continue
            best = max(others, key=precision.__getitem__)
            gain = average_precision(rankings[network.method], rankings[best], found.seed)
            found.add(network.key, OVER_NEXT, {"over": best}, gain, len(scores.refs))


def ranking_figure(bench: Bench, scores: FrameScores) -> Figure:
    """Detection probability over false alarms a frame, a panel for each array."""
    look = Look(one.key for one in bench.contenders)
    size = 4.4 * len(look.arrays) + 0.6, 4.6
    title = f"Detection probability over false alarms: {counted(len(scores.refs), 'frame')}"
    figure, (axes,) = panels(1, len(look.arrays), size, title, sharey=True)
    least, most = SHOWN_FALSE_ALARMS
    places = np.geomspace(least, most, 241)
    for axis, array in zip(axes, look.arrays, strict=True):
        methods = [contender.method for contender in bench.contenders if contender.array.name == array]
        ends = []
        for method in (*methods, TRUTH):
            false, detected = scores.ranking((method, array)).curve()
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


TP, FP, FN, TN = range(4)
RATES = {"detection rate": (TP, (TP, FN)), "false-alarm rate": (FP, (FP, TN)), "precision": (TP, (TP, FP))}
"""Numerator and summands of the denominator of the paper's three metrics."""
RECALL, PRECISION, F1 = "one-to-one recall", "one-to-one precision", "one-to-one F1"
UNSUPPORTED = "peaks that the data do not support"
SCALED_NMSE, SSIM = "NMSE at the best scale", "SSIM of levels"
IMAGE_METRICS = {"NMSE": "nmse", SCALED_NMSE: "scaled_nmse", SSIM: "ssim"}
"""Names in the table, and in the cells."""


class Detection(OfFrames):
    """What is found in scenes, and what is found that is not there?"""

    name = "detection"
    title = "Detection rate, false-alarm rate and precision on unseen scene frames (paper, Fig. 11)"
    caption = (
        "Detection probability over false alarms: the share of the truth's 3 x 3 maxima (13 dB above the noise of all "
        "channels together, within 25 dB of their row's maximum, beyond 5 m) that have a detection of their own within "
        "one range bin and two angle bins, at one threshold for all frames. A false alarm is a detection without such "
        "a maximum that reads more than 10 dB above all that the truth has around it; an image without absolute unit "
        "is read by delay-and-sum. Dotted: the method has no more detections. The truth's own image is the ceiling. "
        "Average precision is the mean over the truth's maxima of the precision at which each is found, 0 if it is "
        "not. Over the next best: of a network, its average precision less that of the best other method, with the "
        "frames drawn for both at once. The other figure is by the paper's rules: every range bin's spectrum "
        "normalised to its maximum, peaks of scipy.signal.find_peaks above 0.5, against the peaks of the truth, over "
        "the prominence that a peak needs. Upper line: a detection counts within 2 bins of a truth, lower line: "
        "within 4. The table has the one-to-one scores and image errors beside them."
    )
    summary = (
        SummaryColumn("AP", AVERAGE_PRECISION, {}),
        SummaryColumn("AP over the next best", OVER_NEXT),
        SummaryColumn("P(detect) at 10 FA", DETECTION_PROBABILITY, at_false_alarms(10)),
        SummaryColumn("NMSE, best scale", SCALED_NMSE),
        SummaryColumn("SSIM", SSIM),
        SummaryColumn("F1", F1, {"d_max": f"{D_MAX_BINS[0]} bins"}),
        SummaryColumn("unsupported peaks", UNSUPPORTED),
    )

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        scores = self.scores(bench, results)
        for contender in bench.contenders:
            counts = scores.gathered(contender.key, "paper")  # (frames, d_max, prominence, 4)
            for (metric, (part, whole)), (d, d_max), (p, prominence) in product(
                RATES.items(), enumerate(D_MAX_BINS), enumerate(PROMINENCES)
            ):
                parts, wholes = counts[:, d, p, part], counts[:, d, p, list(whole)].sum(axis=-1)
                found.ratio(contender.key, metric, _sweep(d_max, prominence), parts, wholes)
            count_frames(scores, contender.key, {}, found)
        for array in bench.arrays:
            count_ranking(scores, (TRUTH, array.name), {}, found)
        count_gains(bench, scores, found)

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        scores = self.scores(bench, results)
        look = Look(one.key for one in bench.contenders)
        title = f"{self.title}: {counted(len(scores.refs), 'frame')}"
        figure, axes = panels(len(D_MAX_BINS), len(RATES), (11.0, 6.4), title, sharex=True, sharey="col")
        for of_distance, d_max in zip(axes, D_MAX_BINS, strict=True):
            swept = [_sweep(d_max, prominence) for prominence in PROMINENCES]
            for axis, metric in zip(of_distance, RATES, strict=True):
                for one in bench.contenders:
                    style = {"color": look.colour(one.method), "ls": look.line(one.array.name), "lw": 1.3}
                    axis.plot(PROMINENCES, found.values(one.key, metric, swept), **style)
                axis.grid(alpha=0.25)
                axis.set_title(f"{metric}, $d_{{max}}$ = {d_max} bins")
        # Both of a column have the same limits, which do not move any more: after all lines.
        for axis in axes.ravel():
            axis.set_ylim(bottom=0.0)
        for axis in axes[-1]:
            axis.set_xlabel("prominence of a peak, of the maximum")
        legend_below(figure, [*look.method_handles(), *look.array_handles(markers=False)])
        return {"detection-probability": ranking_figure(bench, scores), self.name: figure}


def count_frames(scores: FrameScores, key: tuple[str, str], condition: Condition, found: Numbers) -> None:
    """Average precision, one-to-one scores and image errors over frames."""
    count_ranking(scores, key, condition, found)
    strict = scores.gathered(key, "strict")  # (frames, d_max, 3)
    for d, d_max in enumerate(D_MAX_BINS):
        tp, fp, fn = np.moveaxis(strict[:, d], -1, 0)
        of = {**condition, "d_max": f"{d_max} bins"}
        found.ratio(key, RECALL, of, tp, tp + fn)
        found.ratio(key, PRECISION, of, tp, tp + fp)
        found.ratio(key, F1, of, 2 * tp, 2 * tp + fp + fn)
    residual = dict(zip(RESIDUAL, np.moveaxis(scores.gathered(key, "residual"), -1, 0), strict=True))
    for metric, part, whole in (
        (UNSUPPORTED, "unsupported", "lines"),
        ("range bins explained to the noise", "explained_rows", "rows"),
        ("energy that the peaks leave", "left", "energy"),
    ):
        found.ratio(key, metric, condition, residual[part], residual[whole])
    for metric, name in IMAGE_METRICS.items():
        found.mean(key, metric, condition, scores.gathered(key, name))


def _sweep(d_max: int, prominence: float) -> Condition:
    return {"d_max": f"{d_max} bins", "prominence": f"{prominence:g}"}
