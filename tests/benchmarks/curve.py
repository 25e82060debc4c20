"""What more frames and more steps of training are worth: docs/weights.png and its table in docs/notes/weights.md.

    python tests/benchmarks/curve.py DATASET RUN... [--array sparse6] [--out docs/weights.png]

DATASET is ``build/study/unseen`` of ``make study``; each RUN a folder of ``trainer fit``. Average precision and NMSE of
the test split at its strongest Doppler peaks over the frames that a run was trained on, with bootstrap intervals over
the judged frames; runs of equal steps, begun from nothing, are one line, and runs begun from weights stand by
themselves. Beside them the best untrained method, told the motion, with the same receivers and with all.
"""

from __future__ import annotations

import json
from collections import defaultdict
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
from trainer.run.folder import load_imager

matplotlib.use("Agg")
from matplotlib import pyplot as plt

UNTRAINED = "likes-view-ego"
Score = tuple[Interval, Interval]


def main(
    dataset: Path,
    runs: list[Path],
    array: Annotated[str, typer.Option()] = "sparse6",
    out: Annotated[Path, typer.Option()] = Path("docs/weights.png"),
) -> None:
    opened = open_dataset(dataset)
    radar = radar_of(opened.description(), dataset / MANIFEST)
    frames = list(opened.frames("test", ("range_channel", "velocity", "image")))

    def score(name: str, answer: Answer) -> Score:
        ranking, errors = scored(answer, frames, radar)
        found = average_precision(ranking), bootstrap_mean(errors)
        row(array, name, *found)
        return found

    levels = {of: score(f"{of}, {UNTRAINED}", array_answer(UNTRAINED, choose_array(of, radar), radar))
              for of in (array, "full")}  # fmt: skip
    lines: dict[str, list[tuple[int, Score]]] = defaultdict(list)
    for folder in runs:
        about = json.loads((folder / "run.json").read_text())
        used = sum(source["frames"]["train"] for source in about["datasets"])
        line = f"{about['config']['steps']} steps" + ("" if about["start"] is None else " more, from weights")
        name = f"{line}, {used} frames"
        lines[line].append((used, score(name, network_answer(*load_imager(folder)))))
    draw(lines, levels, out)


def draw(lines: dict[str, list[tuple[int, Score]]], levels: dict[str, Score], out: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for panel, (axis, title) in enumerate(zip(axes, ("average precision", "NMSE"), strict=True)):
        for (of, level), style in zip(levels.items(), (":", "--"), strict=True):
            axis.axhline(level[panel].value, color="0.4", linestyle=style, label=f"{UNTRAINED}, {of}")
        for name, points in lines.items():
            points = sorted(points, key=lambda point: point[0])
            found = [score[panel] for _, score in points]
            spread = [[one.value - one.low for one in found], [one.high - one.value for one in found]]
            axis.errorbar([used for used, _ in points], [one.value for one in found], spread,
                          fmt="o-", capsize=3, label=name)  # fmt: skip
        counts = sorted({used for points in lines.values() for used, _ in points})
        axis.set(xscale="log", xlabel="frames trained on", title=title)
        axis.set_xticks(counts, [str(count) for count in counts])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    typer.run(main)
