"""``trainer predict``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def predict(
    run: Annotated[Path, typer.Argument(help="Run folder of trainer fit.", show_default=False)],
    source: Annotated[
        str,
        typer.Argument(
            metavar="INPUT", help="A dataset, also s3:// or gs://, or a cube as .npy or .npz.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the images; new or empty.", show_default=False)],
    radar: Annotated[str | None, typer.Option(help="Radar of a .npy cube: a preset or a TOML file.")] = None,
    split: Annotated[str, typer.Option(help="Of a dataset: train, validation, test or all.")] = "test",
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="A PNG for each frame.")] = True,
    points: Annotated[
        bool, typer.Option("--points", help="Also the targets as a list: a column 'detections', the strongest first.")
    ] = False,
    points_format: Annotated[
        str, typer.Option(help="Of the list: parquet, the column alone; csv or pcd, files for other tools as well.")
    ] = "parquet",
) -> None:
    """Image frames with a trained network, every Doppler peak of a range bin included."""
    from trainer.run.predict import predict as run_predict

    run_predict(run, source, out, radar, split, pictures, points=points, points_format=points_format)
