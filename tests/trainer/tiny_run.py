"""Run folders for tests of what comes after training."""

from __future__ import annotations

from pathlib import Path

import torch
from tiny_radar import RADAR, tiny

from shared.radar import Radar
from trainer.data.arrays import ArrayChoice
from trainer.run.configuration import FitConfig
from trainer.run.folder import Fingerprint, Run, save_weights, write_run
from trainer.run.imager import Imager

MINE = ArrayChoice(name="mine", rx=(0, 1, 2, 5))


def make_run(directory: Path, **changes: object) -> Path:
    """A run with random weights: what is tested here does not depend on what they learned."""
    return run_of(directory, RADAR, tiny(**changes))


def run_of(
    directory: Path, radar: Radar, config: FitConfig, array: ArrayChoice = MINE, datasets: tuple[Fingerprint, ...] = ()
) -> Path:
    """The same of any radar of six RX."""
    torch.manual_seed(0)
    imager = Imager(config, radar, array)
    directory.mkdir()
    write_run(directory, Run(config=config, radar=radar, array=array, datasets=datasets))
    save_weights(directory, imager)
    return directory
