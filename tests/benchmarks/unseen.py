"""Runs and untrained methods on drives through cities that no weights have seen: the tables of docs/notes/weights.md.

    python tests/benchmarks/unseen.py DATASET [RUN...] [--array sparse6]

DATASET is ``build/study/unseen`` of ``make study``. Frames of the test split at their strongest Doppler peaks; average
precision and NMSE with bootstrap intervals over the frames, of all and of each city; then each less the best untrained
method that is told the motion, paired. All channels stand beside the array; they have more truth cells above their
noise, so that no difference to them is paired.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from ego_motion import VIEWS, difference, judged_frames, row, scores

from trainer.data.arrays import choose_array
from trainer.metrics.bootstrap import bootstrap_mean
from trainer.metrics.cells import average_precision, pooled
from trainer.run.answers import Answer, array_answer, network_answer
from trainer.run.folder import load_imager
from trainer.run.pretrained import pretrained_run

FULL, REFERENCE = "full", "likes-view-ego"


def main(
    dataset: Path,
    runs: Annotated[list[Path] | None, typer.Argument()] = None,
    array: Annotated[str, typer.Option()] = "sparse6",
) -> None:
    frames, radar = judged_frames(dataset)
    answers: dict[str, Answer] = {f"{of}, {view}": array_answer(view, choose_array(of, radar), radar)
               for of in (array, FULL) for view in VIEWS}  # fmt: skip
    for folder in (pretrained_run(array), *(runs or ())):
        answers[str(folder.name)] = network_answer(*load_imager(folder))
    found = {name: scores(answer, frames, radar) for name, answer in answers.items()}
    scenes = np.array([frame.scene for frame in frames])
    for scene in (None, *dict.fromkeys(scenes.tolist())):
        chosen = np.flatnonzero((scenes == scene) | (scene is None))
        kept = {name: (pooled([cells[i] for i in chosen]), errors[chosen]) for name, (cells, errors) in found.items()}
        for name, (ranking, errors) in kept.items():
            row(scene or "both", name, average_precision(ranking), bootstrap_mean(errors))
            if not name.startswith(FULL) and not name.endswith(REFERENCE):
                below = kept[f"{array}, {REFERENCE}"]
                difference(scene or "both", f"{name} less {REFERENCE}", (ranking, errors), below)


if __name__ == "__main__":
    typer.run(main)
