"""``trainer evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.cli.console import bars, plain_console
from shared.processes.defaults import LARGEST_SEED


def evaluate(
    out: Annotated[Path, typer.Option(help="Folder of the evaluation; new or empty.")],
    dataset: Annotated[
        str | None,
        typer.Argument(
            help="Folder of a dataset with a test split, also s3://, hf:// or https://; none for --measured alone."
        ),
    ] = None,
    run: Annotated[list[Path] | None, typer.Option("--run", help="Run folder of trainer fit; repeatable.")] = None,
    pretrained: Annotated[
        list[str] | None, typer.Option(help="A network that comes with the package: sparse6 or sparse4; repeatable.")
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated: das, das-hamming, das-hann, music, iaa, iaa-view, likes-view, likes-view-ego, omp, "
            "omp-cfar, spice, likes, ml; "
            "of a measured row also music-fbss and line-fit; cnn and unet stand for the runs. By default das, music, "
            "iaa, omp and all runs, of a measured row all."
        ),
    ] = None,
    arrays: Annotated[str, typer.Option(help="Comma-separated: names, or TOML files.")] = "sparse6,sparse4,full",
    experiments: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated: point-spread, street, two-reflectors, detection, doppler, resolution, robustness, "
            "generalisation, noise-only, tradeoff, measured. By default all that apply."
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Most test frames of each kind that are scored.")] = 50,
    shown: Annotated[int, typer.Option(help="Frames to look at in the report.")] = 3,
    trials: Annotated[int, typer.Option(help="Simulated trials of each condition.")] = 120,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same numbers.")] = 0,
    measured: Annotated[
        Path | None,
        typer.Option(help="A measured snapshot of a half-wavelength line, .mat or .npy, or a cube of trainer import."),
    ] = None,
    targets: Annotated[
        int | None, typer.Option(help="Targets in the measured row, where their number is known.")
    ] = None,
    range_m: Annotated[
        float | None, typer.Option("--range", help="Of the row of a measured cube [m]; the strongest one.")
    ] = None,
    model_error: Annotated[
        float | None,
        typer.Option(
            help="Of the measured channels after calibration [dB of the row's power]; the cube's own, or -25."
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes that compute; 0: one a core. The numbers do not depend on it.")
    ] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Keep what is finished in --out.")] = False,
) -> None:
    """Hold runs and classical estimators against each other: metrics, figures, and a page to look at."""
    # torch and matplotlib take seconds to import, and trainer --help should not.
    from shared.radar import validated
    from trainer.evaluation.evaluate import evaluate as run_evaluate
    from trainer.evaluation.experiments.bench import EvaluationConfig
    from trainer.evaluation.experiments.measured_input import read_measured
    from trainer.run.pretrained import pretrained_run

    fields = {
        "runs": (*(run or []), *(pretrained_run(name) for name in pretrained or [])), "methods": _names(methods),
        "arrays": _names(arrays) or (), "experiments": _names(experiments), "frames": frames, "shown": shown,
        "trials": trials, "seed": seed,
    }  # fmt: skip
    config = validated(EvaluationConfig, fields, "trainer evaluate")
    row = None if measured is None else read_measured(measured, targets, range_m, model_error)
    console = plain_console()
    with bars(console) as advance:
        run_evaluate(dataset, out, config, row, resume, workers, console.print, advance)


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
