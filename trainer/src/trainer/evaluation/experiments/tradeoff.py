"""Quality against what it costs: seconds for one image, and parameters to be trained."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from trainer.evaluation.experiments.bench import Bench, Experiment, Results, Task, single_row
from trainer.evaluation.experiments.contenders import look_of
from trainer.evaluation.experiments.detection import SSIM, scene_frames, strict_rows
from trainer.evaluation.experiments.frames import CELLS, frame_tasks, too_small
from trainer.evaluation.report.style import legend_below, new_figure, subplots
from trainer.evaluation.rows import AVERAGE_PRECISION, MetricRow

SHOWN = (AVERAGE_PRECISION, SSIM)
SECONDS, PARAMETERS = "seconds for an image", "trained parameters"


class Tradeoff(Experiment):
    """What does quality cost?"""

    name = "tradeoff"
    cells = CELLS
    title = "Quality against runtime and parameters"
    caption = (
        "Means over the test split's scene frames with their 95 % intervals, over the least of some repeated runs "
        "for one image on the machine that made this report, features included. On the left, beside the networks, "
        "their parameters."
    )

    def obstacle(self, bench: Bench) -> str | None:
        return too_small(bench) if scene_frames(bench) else "the test split has no scene frames"

    def tasks(self, bench: Bench) -> Sequence[Task]:
        return frame_tasks(bench)

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        return [
            single_row(self.name, contender, PARAMETERS, {}, float(contender.parameters))
            for contender in bench.contenders
        ]

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        look = look_of(bench.contenders)
        figure = new_figure(10.0, 4.8, self.title)
        axes = subplots(figure, 1, len(SHOWN))[0]
        for contender in bench.contenders:
            rows = strict_rows(bench, self.name, results, contender, scene_frames(bench), {})
            for axis, metric in zip(axes, SHOWN, strict=True):
                row = next(r for r in rows if r.metric == metric)
                seconds = bench.seconds[contender.method, contender.array.name]
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
