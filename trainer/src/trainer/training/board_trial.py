"""What networks are worth behind imperfect boards: test frames seen by boards of :mod:`trainer.training.imperfections`.

    python -m trainer.training.board_trial DATASET RUN [RUN ...] [--frames N] [--seed K]

A table of the error of the linear image, each frame with its best scale, and of the average precision, for perfect,
calibrated and uncalibrated boards, all with errors and no dead receiver. *Told* are networks that get the board's model
error as part of the noise, as a capture brings it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from shared.dataset.reading import radar_of
from shared.physics.errors import InputError
from shared.physics.units import power_to_db
from shared.signal.model_error import NO_MODEL_ERROR_DB
from trainer.data.shards import ShardDataset
from trainer.metrics.cells import CellScores, score_cells
from trainer.metrics.image import nmse_best_scaled
from trainer.metrics.ranking import pooled
from trainer.run.folder import Run, load_imager, same_radar
from trainer.run.imager import Imager
from trainer.run.imperfections import CALIBRATED, IMPERFECTIONS, Imperfections
from trainer.run.targets import AMPLITUDE, UNITS
from trainer.training.frame_scores import FrameTensors, true_level
from trainer.training.imperfections import BoardErrors

FRAMES = 16
_PERFECT = CALIBRATED.model_copy(update={"perfect": 1.0})
BOARDS: dict[str, Imperfections] = {
    "perfect": _PERFECT,
    **{
        name: one.model_copy(update={"perfect": 0.0, "dead": 0.0})
        for name, one in IMPERFECTIONS.items()
        if one is not None
    },
}
"""By name; a calibration would have told of a dead receiver."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    try:
        print(table(given.dataset, given.runs, given.frames, given.seed))
    except InputError as error:
        sys.exit(f"board_trial: {error}")


def table(dataset: Path, runs: Sequence[Path], frames: int = FRAMES, seed: int = 0) -> str:
    """The Markdown table of runs whose images have amplitudes.

    :param frames: most test frames, evenly spaced
    :raises InputError: no test frames, a run that is not whole, of another radar or without amplitudes
    """
    stored = ShardDataset(dataset, "test")
    chosen = sorted({int(index) for index in np.linspace(0, len(stored) - 1, min(frames, len(stored)))})
    loaded = {path: load_imager(path) for path in runs}
    for path, (run, _) in loaded.items():
        same_radar(run.radar, str(path), radar_of(stored.description, dataset), str(dataset))
        if UNITS[run.config.target] != AMPLITUDE:
            raise InputError(path, f"target = {run.config.target!r}", "a run whose images have amplitudes")
    lines = ["| boards | network | model error | NMSE | AP |", "|---|---|---|---|---|"]
    for name, imperfections in BOARDS.items():
        for path, (run, imager) in loaded.items():
            boards = BoardErrors(imperfections, run.radar, imager.channels.numpy())
            for told in (False, True) if name != "perfect" else (False,):
                scored = [_scored(run, imager, boards, stored[index], index, seed, told) for index in chosen]
                error = np.mean([nmse for nmse, _ in scored])
                precision = pooled([cells for _, cells in scored]).average_precision()
                cells = [name, path.resolve().name, "told" if told else "", f"{error:.3f}", f"{precision:.3f}"]
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _scored(
    run: Run, imager: Imager, boards: BoardErrors, frame: FrameTensors, index: int, seed: int, told: bool
) -> tuple[float, CellScores]:
    """(NMSE at the best scale, what became of the detections) of one frame."""
    noise_power = frame["noise_power"]
    seen, model_error = boards(seed, 0, [index], frame["range_channel"][:1], noise_power[None], np.zeros(1))
    model_error_db = float(power_to_db(float(model_error[0]))) if told else NO_MODEL_ERROR_DB
    with torch.inference_mode():
        images, scores = imager.image_and_score(seen, noise_power[None], model_error_db)
    image, truth = images[0].numpy(), true_level(frame)
    channels, step_m = len(imager.channels), run.radar.waveform.range_step_m
    cells = score_cells(truth, image, float(noise_power), channels, step_m, scores[0].numpy())
    return nmse_best_scaled(image, truth), cells


if __name__ == "__main__":
    main()
