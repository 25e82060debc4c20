"""What more frames and more steps of training are worth: docs/weights.png and its table in docs/notes/weights.md.

    python tests/benchmarks/curve.py DATASET RUN... [--array sparse6] [--out docs/weights.png]

DATASET is ``build/study/unseen`` of ``make study``; each RUN a folder of ``trainer fit``, after the one that it begins
with. Average precision and NMSE of the test split at its strongest Doppler peaks, with bootstrap intervals over the
judged frames: on the left, of runs that begin with nothing, over the frames that they were trained on; on the right, of
all, over steps, those of the runs before it counted. Beside them the best untrained method, told the motion, with the
same receivers and with all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib
import typer
from ego_motion import row, scored

from shared.dataset.folder import MANIFEST, open_dataset
from shared.dataset.reading import radar_of
from trainer.data.arrays import choose_array
from trainer.metrics.bootstrap import Interval, bootstrap_mean
from trainer.metrics.ranking import average_precision
from trainer.run.answers import Answer, array_answer, network_answer
from trainer.run.folder import Start, load_imager

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

UNTRAINED = "likes-view-ego"
TITLES = ("average precision", "NMSE")


@dataclass(frozen=True)
class Point:
    """One run: frames it was trained on, steps in all, whether it begins with weights, and what it scores, by title."""

    frames: int
    steps: int
    begun: bool
    scores: tuple[Interval, Interval]


def main(
    dataset: Path,
    runs: list[Path],
    array: Annotated[str, typer.Option()] = "sparse6",
    out: Annotated[Path, typer.Option()] = Path("docs/weights.png"),
) -> None:
    opened = open_dataset(dataset)
    radar = radar_of(opened.description(), dataset / MANIFEST)
    frames = list(opened.frames("test", ("range_channel", "velocity", "image")))

    def score(name: str, answer: Answer) -> tuple[Interval, Interval]:
        ranking, errors = scored(answer, frames, radar)
        found = average_precision(ranking), bootstrap_mean(errors)
        row(array, name, *found)
        return found

    levels = {of: score(f"{of}, {UNTRAINED}", array_answer(UNTRAINED, choose_array(of, radar), radar))
              for of in (array, "full")}  # fmt: skip
    steps_to: dict[str, int] = {}  # by the hash of the weights
    points = []
    for folder in runs:
        run, imager = load_imager(folder)
        used = sum(source.frames["train"] for source in run.datasets)
        begun = run.start is not None
        steps = run.config.steps + (steps_to[run.start.sha256] if run.start is not None else 0)
        steps_to[Start.of(folder).sha256] = steps
        name = f"{steps} steps, {used} frames{', in stages' if begun else ''}"
        points.append(Point(used, steps, begun, score(name, network_answer(run, imager))))
    draw(points, levels, out)


def draw(points: list[Point], levels: dict[str, tuple[Interval, Interval]], out: Path) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.5), layout="constrained", sharey="row")
    anew = sorted((point for point in points if not point.begun), key=lambda point: point.frames)
    for number, (title, (over_frames, over_steps)) in enumerate(zip(TITLES, axes, strict=True)):
        for axis in (over_frames, over_steps):
            for (of, level), style in zip(levels.items(), (":", "--"), strict=True):
                axis.axhline(level[number].value, color="0.4", linestyle=style, label=f"{UNTRAINED}, {of}")
            axis.grid(alpha=0.3)
        for steps in sorted({point.steps for point in anew}):
            line = [point for point in anew if point.steps == steps]
            _bars(over_frames, [point.frames for point in line], line, number, "o-", f"{steps} steps from nothing")
        stages = [point for point in points if point.begun]
        _bars(over_steps, [point.steps for point in anew], anew, number, "o", "from nothing")
        _bars(over_steps, [point.steps for point in stages], stages, number, "s-", "each from the one before")
        counts = sorted({point.frames for point in anew})
        over_frames.set(xscale="log", xlabel="frames trained on", ylabel=title)
        over_frames.set_xticks(counts, [str(count) for count in counts])
        over_frames.minorticks_off()
        over_steps.set(xlabel="steps in all", xlim=(0.0, None))
    for axis in axes[0]:
        axis.legend(fontsize=8, loc="lower right")
    figure.savefig(out, dpi=110)


def _bars(axis: Axes, places: list[int], points: list[Point], number: int, style: str, label: str) -> None:
    found = [point.scores[number] for point in points]
    spread = [[one.value - one.low for one in found], [one.high - one.value for one in found]]
    axis.errorbar(places, [one.value for one in found], spread, fmt=style, capsize=3, label=label)


if __name__ == "__main__":
    typer.run(main)
