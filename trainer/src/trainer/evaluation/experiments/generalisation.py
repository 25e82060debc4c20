"""Scores of the test frames by scene (does a network image what it was never trained on?), and against their cost."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from shared.dataset import Frame
from shared.physics.errors import figure_text
from trainer.evaluation.experiments.bench import Bench, FrameRef, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.experiments.detection import IMAGE_METRICS, SSIM, count_frames, count_ranking
from trainer.evaluation.experiments.frames import FrameByFrame, FrameScores, OfFrames, grouped
from trainer.evaluation.report.figures import Look, counted, draw_bar, legend_below, panels
from trainer.evaluation.report.tables import AVERAGE_PRECISION, Condition, Numbers
from trainer.evaluation.store import Values
from trainer.run.folder import Fingerprint

SHOWN = (AVERAGE_PRECISION, SSIM)
SECONDS, PARAMETERS = "seconds for an image", "trained parameters"
RUNTIME_REPEATS = 3
"""Runs for one image after a first one, of which the shortest counts: what else a machine does only adds."""


class Generalisation(OfFrames):
    """Is a scene worse than another, and was it trained on?"""

    name = "generalisation"
    title = "Scores by scene"
    caption = (
        "The test frames of each scene apart, and close point targets as a scene of their own. A filled bar belongs "
        "to a network that was trained on other frames of this scene or to an estimator, which is trained on "
        "nothing; a hatched one to a network that never saw the scene, or of which it is not known."
    )

    def refs(self, bench: Bench) -> tuple[FrameRef, ...]:
        return bench.frames

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        for scene, refs in grouped(bench.frames, "scene").items():
            for contender in bench.contenders:
                count_frames(FrameScores(results, refs), contender.key, _condition(bench, contender, scene), found)

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        scenes = grouped(bench.frames, "scene")
        look = Look(one.key for one in bench.contenders)
        width = max(7.0, 1.2 + len(scenes) * (0.28 * len(bench.contenders) + 0.4))
        figure, grid = panels(len(SHOWN), 1, (width, 6.0), self.title, sharex=True)
        axes = grid[:, 0]
        slot = 0.85 / len(bench.contenders)
        for axis, metric in zip(axes, SHOWN, strict=True):
            for place, contender in enumerate(bench.contenders):
                for column, scene in enumerate(scenes):
                    row = found.row(contender.key, metric, _condition(bench, contender, scene))
                    centre = column + (place - 0.5 * (len(bench.contenders) - 1)) * slot
                    unseen = trained_on(bench, contender, scene) in ("no", "unknown")
                    paler = 1.0 - 0.25 * look.arrays.index(contender.array.name)
                    draw_bar(
                        axis, centre, row, 0.9 * slot, color=look.colour(contender.method), alpha=paler,
                        hatch="////" if unseen else None, edgecolor="white", lw=0.0,
                    )  # fmt: skip
            axis.set(ylabel=metric, ylim=(0.0, None))
            axis.grid(axis="y", alpha=0.25)
        labels = [f"{figure_text(scene)}\n{counted(len(refs), 'frame')}" for scene, refs in scenes.items()]
        axes[-1].set_xticks(range(len(scenes)), labels)
        axes[0].set_title(
            f"arrays from left to right, paler and paler: {figure_text(', '.join(look.arrays))}", loc="left"
        )
        legend_below(figure, look.method_handles())
        return {self.name: figure}


def _condition(bench: Bench, contender: Contender, scene: str) -> Condition:
    return {"scene": scene, "trained on it": trained_on(bench, contender, scene)}


def trained_on(bench: Bench, contender: Contender, scene: str) -> str:
    """ "nothing" of an estimator and of what trains on synthetic samples; else "yes", "no", or "unknown".

    A run knows its datasets by their fingerprints. Of this dataset its training scenes are known, of which a run of the
    first frames may have seen some. Another one's are known if it says them: it has the same scene, or none of this
    name. One of the same name and another content may be the same streets with other traffic, or something else.
    """
    if contender.parameters == 0 or not contender.trained_on:
        return "nothing"
    answers = {_seen(bench, fingerprint, scene) for fingerprint in contender.trained_on}
    return next(answer for answer in ("yes", "unknown", "no") if answer in answers)


def _seen(bench: Bench, fingerprint: Fingerprint, scene: str) -> str:
    contents = {record.content_sha256 for record in bench.scenes or () if record.name == scene}
    if fingerprint.sha256 == bench.data_sha256:
        # Of the first frames of a dataset a run may have seen fewer scenes. Close targets are of none that is recorded.
        of_run = fingerprint.scenes if contents else None
        looked_at = of_run is None or scene in {record.name for record in of_run}
        return "yes" if looked_at and scene in bench.training_scenes else "no"
    if fingerprint.scenes is None or not contents:  # close targets are of no scene
        return "unknown"
    if any(record.content_sha256 in contents for record in fingerprint.scenes):
        return "yes"
    return "unknown" if scene in {record.name for record in fingerprint.scenes} else "no"


class Runtime(FrameByFrame):
    """Seconds for one image of each contender, one thread: the first test frame, whole."""

    name = "runtime"

    def frames(self, bench: Bench) -> Sequence[FrameRef]:
        return bench.frames[:1]

    def score(self, bench: Bench, contender: Contender, place: int, scene: Frame) -> Values:
        seconds = []
        for _ in range(1 + RUNTIME_REPEATS):
            start = time.perf_counter()
            contender.answer.image(scene.range_channel[0], scene.noise_power)
            seconds.append(time.perf_counter() - start)
        return {"seconds": np.asarray(min(seconds[1:]))}

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        for contender in bench.contenders:
            found.known(contender.key, SECONDS, {}, bench.seconds[contender.key])


class Tradeoff(OfFrames):
    """What does quality cost?"""

    name = "tradeoff"
    title = "Quality against runtime and parameters"
    caption = (
        "Means over the test split's scene frames with their 95 % intervals, over the least of some repeated runs "
        "for one image on the machine that made this report, features included. On the left, beside the networks, "
        "their parameters."
    )

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        for contender in bench.contenders:
            found.known(contender.key, PARAMETERS, {}, float(contender.parameters))

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        scores, look = self.scores(bench, results), Look(one.key for one in bench.contenders)
        figure, (axes,) = panels(1, len(SHOWN), (10.0, 4.8), self.title)
        for contender in bench.contenders:
            quality = Numbers(self.name, bench.config.seed)
            count_ranking(scores, contender.key, {}, quality)
            quality.mean(contender.key, SSIM, {}, scores.gathered(contender.key, IMAGE_METRICS[SSIM]))
            for axis, metric in zip(axes, SHOWN, strict=True):
                row = quality.row(contender.key, metric, {})
                seconds = bench.seconds[contender.key]
                style = {"color": look.colour(contender.method), "marker": look.marker(contender.array.name)}
                axis.plot(seconds, row.value, ms=7, ls="", **style)
                axis.plot([seconds, seconds], [row.low, row.high], color=look.colour(contender.method), lw=1.0)
                if contender.parameters and axis is axes[0]:
                    text = f"{contender.parameters / 1e6:.2g} M"
                    axis.annotate(text, (seconds, row.value), xytext=(7, 4), textcoords="offset points", fontsize=7)
        for axis, metric in zip(axes, SHOWN, strict=True):
            axis.set(xscale="log", xlabel="seconds for one image", ylabel=metric)
            axis.grid(alpha=0.25, which="both")
            axis.margins(0.12)
        legend_below(figure, [*look.method_handles(), *look.array_handles(lines=False)])
        return {self.name: figure}
