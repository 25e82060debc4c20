"""``trainer fit``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo

from shared.cli.console import plain_console
from shared.processes.defaults import LARGEST_SEED

BY_RECIPE = "by recipe and device"
NO_START = "none"
"""In place of a run to begin with. A run folder of this name is ./none."""


def _by_recipe(meaning: str) -> OptionInfo:
    """An option of a field that recipe and device state where the user does not."""
    return typer.Option(help=meaning, show_default=BY_RECIPE)


def fit(
    datasets: Annotated[
        list[str], typer.Argument(help="Folders of datasets of one radar; also s3://, gs://, hf:// and https://.")
    ],
    out: Annotated[Path, typer.Option(help="Run folder; new or empty.")],
    array: Annotated[str, typer.Option(help="full, sparse6, sparse4 or a TOML file with rx = [...].")] = "sparse6",
    recipe: Annotated[
        str, typer.Option(help="recommended, paper (its network, features, target), or doa.")
    ] = "recommended",
    config: Annotated[
        Path | None, typer.Option(help="TOML file of a run's fields, e.g. steps = 600; options count before it.")
    ] = None,
    model: Annotated[str | None, _by_recipe("unrolled, spectral-unet, attention-unet or doa-cnn.")] = None,
    features: Annotated[str | None, _by_recipe("snapshots, adaptive, paper or covariance.")] = None,
    target: Annotated[str | None, _by_recipe("row, paper, class or doa.")] = None,
    width: Annotated[int | None, _by_recipe("Channels of the network's first level.")] = None,
    hidden: Annotated[int | None, _by_recipe("Units of the spectral network's angular mixing.")] = None,
    steps: Annotated[int | None, _by_recipe("Optimiser steps.")] = None,
    batch: Annotated[int | None, _by_recipe("Frames of one forward pass.")] = None,
    accumulate: Annotated[int | None, _by_recipe("Batches of one optimiser step.")] = None,
    points: Annotated[int | None, _by_recipe("Crops of online point targets beside each frame.")] = None,
    imperfections: Annotated[
        str | None, _by_recipe("Of the boards that see the training data: none, calibrated or uncalibrated.")
    ] = None,
    rows: Annotated[int | None, _by_recipe("Range bins of a training crop; 0: whole images.")] = None,
    learning_rate: Annotated[float | None, _by_recipe("Peak learning rate.")] = None,
    precision: Annotated[str | None, _by_recipe("32 or bf16.")] = None,
    validate_every: Annotated[int | None, _by_recipe("Steps from one validation to the next.")] = None,
    patience: Annotated[int | None, _by_recipe("Validations without gain before stopping; 0: never.")] = None,
    frames: Annotated[
        int | None,
        typer.Option(help="Train and validate with the first N frames of each dataset; 0: all.", show_default="0"),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="RUN|sparse6|sparse4|none",
            help="Begin with the weights of this run, of a network that comes with the package, or with random ones.",
            show_default="the shipped weights where they fit",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same weights on one device.", show_default="0"),
    ] = None,
    weight: Annotated[list[float] | None, typer.Option(help="Share of each dataset, in their order.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Reading processes beside the training one.")] = 0,
    devices: Annotated[int, typer.Option(min=1, help="GPUs, or processes on a CPU; torchrun says it by itself.")] = 1,
    check: Annotated[bool, typer.Option("--check/--no-check", help="Hash every shard first.")] = True,
    logger: Annotated[str, typer.Option(help="Of the curves: tensorboard, wandb, mlflow or none.")] = "tensorboard",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out.")] = False,
) -> None:
    """Train a network on datasets of the factory."""
    # Lightning takes seconds to import, and trainer --help should not.
    from shared.dataset.locations import locate
    from trainer.run.pretrained import pretrained_names, pretrained_run
    from trainer.training.fit import FitRequest
    from trainer.training.fit import fit as run_fit
    from trainer.training.processes import is_first
    from trainer.training.start import SHIPPED, configuration

    given = {
        "model": model, "features": features, "target": target, "width": width, "hidden": hidden, "steps": steps,
        "batch": batch, "accumulate": accumulate, "rows": rows, "learning_rate": learning_rate, "seed": seed,
        "precision": precision, "validate_every": validate_every, "patience": patience, "points": points,
        "imperfections": imperfections, "frames": frames,
    }  # fmt: skip
    announce = plain_console().print
    begin: Path | str | None = SHIPPED
    if start is not None:
        shipped = {name: pretrained_run(name) for name in pretrained_names()}
        begin = None if start == NO_START else shipped.get(start, Path(start))
    request = FitRequest(
        datasets, out, configuration(recipe, given, config), array=array, weights=weight, start=begin, resume=resume,
        workers=workers, check=check, devices=devices, logger=logger,
    )  # fmt: skip
    run_fit(request, announce)
    if not is_first():
        return
    # The located name is shown: a URI as given may hold a key.
    data, run = shlex.quote(str(locate(datasets[0]))), shlex.quote(str(out))
    announce(f"run in {out}; curves: tensorboard --logdir {run}; next: trainer predict {run} {data} --out DIR")
