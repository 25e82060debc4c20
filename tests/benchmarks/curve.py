"""What more frames and more steps of training are worth: docs/weights.png and its table in docs/notes/weights.md.

    python tests/benchmarks/curve.py DATASET RUN... [--array sparse6] [--out docs/weights.png]

DATASET is ``build/study/unseen`` of ``make study``; each RUN a folder of ``trainer fit``, after the one that it begins
with. Average precision and NMSE of the test split at its strongest Doppler peaks, with bootstrap intervals over the
judged frames, over steps, those of the runs before counted. Beside them the best untrained method, told the motion,
with the same receivers and with all.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import matplotlib
import typer
from answers import judged_frames, print_row, scores, untrained

from trainer.metrics.bootstrap import Interval
from trainer.run.answers import Answer, network_answer
from trainer.run.folder import Start, load_imager, read_run

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

UNTRAINED = "likes-view-ego"
TITLES = ("average precision", "NMSE")
BESIDE = 250
"""Steps by which a run that begins with nothing is drawn to the right."""


@dataclass(frozen=True)
class Point:
    """One run: frames it was trained on, steps in all, whether another begins with its weights or it with another's,
    and what it scores, by title."""

    frames: int
    steps: int
    stage: bool
    scores: tuple[Interval, Interval]


def main(
    dataset: Path,
    runs: list[Path],
    array: Annotated[str, typer.Option()] = "sparse6",
    out: Annotated[Path, typer.Option()] = Path("docs/weights.png"),
) -> None:
    frames, radar = judged_frames(dataset)

    def score(name: str, answer: Answer) -> tuple[Interval, Interval]:
        found = scores(answer, frames, radar).intervals()
        print_row(array, name, found)
        return found

    levels = {of: score(f"{of}, {UNTRAINED}", untrained([UNTRAINED], of, radar)[UNTRAINED])
              for of in (array, "full")}  # fmt: skip
    own = {folder: Start.of(folder).sha256 for folder in runs}
    begun_with = {run.start.sha256 for folder in runs if (run := read_run(folder)).start is not None}
    steps_to: dict[str, int] = {}  # by the hash of the weights
    points = []
    for folder in runs:
        run, imager = load_imager(folder)
        used = sum(source.frames["train"] for source in run.datasets)
        steps = run.config.steps + (steps_to[run.start.sha256] if run.start is not None else 0)
        steps_to[own[folder]] = steps
        found = score(f"{steps} steps, the last {run.config.steps} on {used} frames", network_answer(run, imager))
        points.append(Point(used, steps, run.start is not None or own[folder] in begun_with, found))
    draw(points, levels, out)


def draw(points: list[Point], levels: dict[str, tuple[Interval, Interval]], out: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    stages = [point for point in points if point.stage]
    for number, (title, axis) in enumerate(zip(TITLES, axes, strict=True)):
        for (of, level), style in zip(levels.items(), (":", "--"), strict=True):
            axis.axhline(level[number].value, color="0.4", linestyle=style, label=f"{UNTRAINED}, {of}")
        _bars(axis, stages, number, "s-", "each from the one before")
        for index, point in enumerate(point for point in points if not point.stage):
            beside = replace(point, steps=point.steps + BESIDE * (index + 1))  # the same steps: they would hide another
            _bars(axis, [beside], number, "o", f"from nothing on {point.frames} frames")
        for point in stages:
            place = (point.steps, point.scores[number].value)
            axis.annotate(f"{point.frames} frames", place, (6, -12), textcoords="offset points", fontsize=8)
        axis.set(xlabel="steps in all", ylabel=title, xlim=(0.0, 1.3 * max(point.steps for point in points)))
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="lower right")
    figure.savefig(out, dpi=110)


def _bars(axis: Axes, points: list[Point], number: int, style: str, label: str) -> None:
    found = [point.scores[number] for point in points]
    spread = [[one.value - one.low for one in found], [one.high - one.value for one in found]]
    axis.errorbar([point.steps for point in points], [one.value for one in found], spread, fmt=style, capsize=3,
                  label=label)  # fmt: skip


if __name__ == "__main__":
    typer.run(main)
