"""A small fit and what it leaves behind; run folders for tests of what comes after training."""

import csv
from pathlib import Path
from typing import Any

import torch
from tiny_radar import RADAR, TINY, tiny

from shared.radar import Radar
from trainer import fit
from trainer.data.arrays import ArrayChoice
from trainer.run.configuration import FitConfig
from trainer.run.folder import CHECKPOINT, METRICS, Fingerprint, Run, save_weights, write_run
from trainer.run.imager import Imager

MINE = ArrayChoice(name="mine", rx=(0, 1, 2, 5))


def run(dataset: Any, out: Path, config: FitConfig = TINY, **arguments: Any) -> tuple[Run, list[str]]:
    lines: list[str] = []
    result = fit([dataset], out, config=config, array="full", announce=lines.append, **arguments)
    return result, lines


def last_state(out: Path) -> dict[str, torch.Tensor]:
    return torch.load(out / CHECKPOINT, weights_only=True)["state_dict"]


def metrics(out: Path) -> list[dict[str, str]]:
    with (out / METRICS).open() as handle:
        return list(csv.DictReader(handle))


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
