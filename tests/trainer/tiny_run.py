"""Run folders for tests of what comes after training."""

from __future__ import annotations

from pathlib import Path

import torch
from tiny_radar import RADAR, tiny

from trainer.data.arrays import ArrayChoice
from trainer.run.folder import Run, save_weights, write_run
from trainer.run.imager import Imager


def make_run(directory: Path, **changes: object) -> Path:
    """A run with random weights: what is tested here does not depend on what they learned."""
    config = tiny(**changes)
    array = ArrayChoice(name="mine", rx=(0, 1, 2, 5))
    torch.manual_seed(0)
    imager = Imager(config, RADAR, array)
    directory.mkdir()
    write_run(directory, Run(config=config, radar=RADAR, array=array, datasets=()))
    save_weights(directory, imager)
    return directory
