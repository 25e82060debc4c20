"""What is one more world to train on worth? Networks of one, two and more scenes on frames that none of them saw.

``python examples/worlds.py UNSEEN RUN RUN [RUN ...]`` prints the average precision of every network and what it gains
over the one of the fewest scenes, and draws both into build/examples/worlds/worlds.png. The networks are of one array
and, for a fair comparison, of as many frames and the same options. docs/notes/worlds.md has the commands that make
them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from trainer.evaluation.evaluate import open_bench
from trainer.evaluation.experiments.detection import Detection
from trainer.evaluation.experiments.frames import FrameScores
from trainer.evaluation.experiments.generalisation import trained_on
from trainer.evaluation.options import EvaluationConfig
from trainer.metrics.bootstrap import Interval
from trainer.metrics.cells import average_precision
from trainer.run.folder import read_run

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "worlds"
ARRAY = os.environ.get("EXAMPLES_ARRAY", "sparse6")


def seen_by(run: Path) -> tuple[int, str]:
    """(number of scenes that a run was trained on, whether --populate put something into them)."""
    scenes = {scene.content_sha256: scene for data in read_run(run).trained_on for scene in data.scenes or ()}
    return len(scenes), "populated" if any(scene.populate for scene in scenes.values()) else "bare"


class Point(NamedTuple):
    """What a network of some scenes is worth.

    :param precision: average precision
    :param gain: over the network of the fewest scenes
    """

    scenes: int
    kind: str
    precision: Interval
    gain: Interval


def compare(unseen: Path, runs: Sequence[Path]) -> list[Point]:
    """A point for each run, the fewest scenes first.

    Both of a gain are drawn on the same frames, so that its interval is narrower than those of the two numbers.
    """
    runs = sorted(runs, key=seen_by)
    bench, _ = open_bench(str(unseen), EvaluationConfig(run=tuple(runs), methods=("unet",), arrays=(ARRAY,)))
    refs = Detection().refs(bench)
    for contender in bench.contenders:
        for scene in {ref.scene for ref in refs}:
            if trained_on(bench, contender, scene) != "no":
                sys.exit(f"{contender.method} may have been trained on scene {scene!r}")
    scores = FrameScores({task.key: task.compute() for task in Detection().tasks(bench)}, refs)
    of_run = {one.method.partition(":")[2]: scores.ranking(one.key) for one in bench.contenders}
    rankings = [of_run[run.resolve().name] for run in runs]
    return [
        Point(*seen_by(run), average_precision(one), average_precision(one, rankings[0]))
        for run, one in zip(runs, rankings, strict=True)
    ]


def draw(points: Sequence[Point]) -> Figure:
    """Average precision over the number of scenes above, the gain below."""
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    for kind in dict.fromkeys(point.kind for point in points):
        line = [point for point in points if point.kind == kind]
        for axis, values in zip(axes, ([one.precision for one in line], [one.gain for one in line]), strict=True):
            spread = [[one.value - one.low for one in values], [one.high - one.value for one in values]]
            axis.errorbar([one.scenes for one in line], [one.value for one in values], spread, fmt="o-", label=kind)
    axes[0].set(ylabel="average precision", title=f"Trained on scenes that are not among the test's, {ARRAY}")
    axes[0].legend(frameon=False)
    axes[1].set(xlabel="scenes trained on", ylabel="gain over the fewest scenes")
    axes[1].axhline(0.0, color="black", lw=0.8)
    return figure


def main() -> None:
    """Print the table, draw the chart."""
    unseen, *runs = map(Path, sys.argv[1:])
    rows = compare(unseen, runs)
    print("| scenes | trained on | average precision | gain over the fewest |\n|---|---|---|---|")
    for scenes, kind, precision, gain in rows:
        cells = [f"{one.value:+.3f} ({one.low:+.3f} to {one.high:+.3f})" for one in (precision, gain)]
        print(f"| {scenes} | {kind} | {cells[0].replace('+', '')} | {cells[1]} |")
    OUT.mkdir(parents=True, exist_ok=True)
    draw(rows).savefig(OUT / "worlds.png", dpi=90)


if __name__ == "__main__":
    main()
