"""``trainer fit``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from pydantic import ValidationError
from rich.console import Console

from shared.dataset.locations import locate
from shared.physics.errors import InputError
from shared.radar import first_validation_error
from trainer.run.configuration import FitConfig

GPU = {"steps": 13_000, "rows": 0, "width": 24, "hidden": 768, "precision": "bf16", "validate_every": 500, "batch": 8}
"""What a GPU changes: whole images, a wider network, six epochs of the paper's 17 500 frames."""
PAPER = {
    "model": "attention-unet", "features": "paper", "target": "paper", "width": 64, "rows": 0, "batch": 2,
    "accumulate": 4, "learning_rate": 1e-4, "foreground": 0.0, "augment": False, "points": 0,
}  # fmt: skip
"""The paper's own recipe."""

DOA = {
    "model": "doa-cnn", "features": "covariance", "target": "doa", "width": 256, "rows": 64, "batch": 2,
    "steps": 4000, "learning_rate": 1e-3, "weight_decay": 0.0, "augment": False, "points": 0,
}  # fmt: skip
"""The direction-of-arrival network that the paper compares with, on online samples of 64 snapshots.

Small batches learn more in the same time: ``trainer fit DIR --array sparse4 --recipe doa --precision bf16``, one
thread, takes 120 s of the processor with ``--batch 8 --steps 200``, to a validation loss of 0.0289, and 150 s with
``--batch 2 --steps 700``, to 0.0264.
"""


def fit(
    datasets: Annotated[
        list[str], typer.Argument(help="Folders of datasets of one radar; also s3:// and gs://.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", help="Run folder; new or empty.", show_default=False)],
    array: Annotated[str, typer.Option(help="full, sparse6, sparse4 or a TOML file with rx = [...].")] = "sparse6",
    recipe: Annotated[
        str, typer.Option(help="recommended, paper (its network, features, target), or doa.")
    ] = "recommended",
    model: Annotated[str | None, typer.Option(help="spectral-unet, attention-unet or doa-cnn.")] = None,
    features: Annotated[str | None, typer.Option(help="adaptive, row, paper or covariance.")] = None,
    target: Annotated[str | None, typer.Option(help="row, paper, class or doa.")] = None,
    width: Annotated[int | None, typer.Option(help="Channels of the network's first level.")] = None,
    hidden: Annotated[int | None, typer.Option(help="Units of the spectral network's angular mixing.")] = None,
    steps: Annotated[int | None, typer.Option(help="Optimiser steps.")] = None,
    batch: Annotated[int | None, typer.Option(help="Frames of one forward pass.")] = None,
    accumulate: Annotated[int | None, typer.Option(help="Batches of one optimiser step.")] = None,
    points: Annotated[int | None, typer.Option(help="Crops of online point targets beside each frame.")] = None,
    rows: Annotated[int | None, typer.Option(help="Range bins of a training crop; 0: whole images.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Peak learning rate.")] = None,
    precision: Annotated[str | None, typer.Option(help="32 or bf16.")] = None,
    validate_every: Annotated[int | None, typer.Option(help="Steps from one validation to the next.")] = None,
    patience: Annotated[int | None, typer.Option(help="Validations without gain before stopping; 0: never.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same weights on one device.")] = 0,
    weight: Annotated[list[float] | None, typer.Option(help="Share of each dataset, in their order.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Reading processes beside the training one.")] = 0,
    devices: Annotated[int, typer.Option(min=1, help="GPUs, or processes on a CPU.")] = 1,
    check: Annotated[bool, typer.Option("--check/--no-check", help="Hash every shard first.")] = True,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
) -> None:
    """Train a network on datasets of the factory."""
    # Lightning takes seconds to import, and trainer --help should not.
    from trainer.training.fit import fit as run_fit

    recipes: dict[str, dict] = {"recommended": {}, "paper": PAPER, "doa": DOA}
    if recipe not in recipes:
        raise InputError("--recipe", repr(recipe), "recommended, paper or doa")
    given = {
        "model": model, "features": features, "target": target, "width": width, "hidden": hidden, "steps": steps,
        "batch": batch, "accumulate": accumulate, "rows": rows, "learning_rate": learning_rate,
        "precision": precision, "validate_every": validate_every, "patience": patience, "points": points,
    }  # fmt: skip
    fields = GPU if torch.cuda.is_available() else {"precision": _processor_precision()}
    fields = fields | recipes[recipe] | {name: value for name, value in given.items() if value is not None}
    try:
        config = FitConfig.model_validate(fields | {"seed": seed})
    except ValidationError as error:
        raise InputError("trainer fit", *first_validation_error(error)) from error
    console = Console(soft_wrap=True, highlight=False)

    def announce(line: str) -> None:
        console.print(line, markup=False)

    run_fit(datasets, out, config, array, weight, resume, workers, check, devices, announce)
    # The located name: a URI as given may hold a key.
    first = locate(datasets[0])
    announce(f"run in {out}; curves: tensorboard --logdir {out}; next: trainer predict {out} {first} --out DIR")


def _processor_precision() -> str:
    """bfloat16 where the processor computes in it, which halves the time of a step; elsewhere it is slower."""
    capabilities = torch.cpu.get_capabilities()
    return "bf16" if capabilities.get("avx512_bf16") or capabilities.get("amx_bf16") else "32"
