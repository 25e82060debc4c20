"""A small fit, and what it leaves behind."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import torch
from tiny_radar import TINY

from trainer import fit
from trainer.run.configuration import FitConfig
from trainer.run.folder import CHECKPOINT, METRICS, Run


def run(dataset: Any, out: Path, config: FitConfig = TINY, **arguments: Any) -> tuple[Run, list[str]]:
    lines: list[str] = []
    result = fit([dataset], out, config=config, array="full", announce=lines.append, **arguments)
    return result, lines


def last_state(out: Path) -> dict[str, torch.Tensor]:
    return torch.load(out / CHECKPOINT, weights_only=True)["state_dict"]


def metrics(out: Path) -> list[dict[str, str]]:
    with (out / METRICS).open() as handle:
        return list(csv.DictReader(handle))
