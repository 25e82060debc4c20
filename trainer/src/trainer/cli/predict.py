"""``trainer predict`` and ``trainer export``: what a run is used for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.cli.ending import Interrupted
from shared.physics.errors import InputError

EXTRA = "pip install 'sparseradar-trainer[export]'"


def predict(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="[RUN] INPUT",
            help="Run folder of trainer fit, unless --pretrained or --method; then a dataset, also s3://, hf:// "
            "or https://, or a cube as .npy or .npz.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the images; new or empty.")],
    pretrained: Annotated[
        str | None, typer.Option(help="A network that comes with the package, in place of RUN: sparse6 or sparse4.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="A classical estimator in place of a network, for any array: das, das-hamming, das-hann, music, iaa, "
            "iaa-view, likes-view, likes-view-ego, omp, omp-cfar, spice, likes or ml."
        ),
    ] = None,
    radar: Annotated[str | None, typer.Option(help="Radar of a .npy cube: a preset or a TOML file.")] = None,
    split: Annotated[str, typer.Option(help="Of a dataset: train, validation, test or all.")] = "test",
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="A PNG for each frame.")] = True,
    points: Annotated[
        bool, typer.Option("--points", help="Also the targets as a list: a column 'detections', the strongest first.")
    ] = False,
    points_format: Annotated[
        str, typer.Option(help="Of the list: parquet, the column alone; csv or pcd, files for other tools as well.")
    ] = "parquet",
    false_alarms: Annotated[float, typer.Option(help="Of the list: expected lines of a frame of noise alone.")] = 1.0,
    cells: Annotated[
        str, typer.Option(help="Of the list: peaks, three of a range bin; all, of a cube, what passes OS-CFAR.")
    ] = "peaks",
    animation: Annotated[
        bool,
        typer.Option("--animation", help="Also animation.gif: images and detections, frame by frame; with --points."),
    ] = False,
    velocity: Annotated[
        str | None,
        typer.Option(
            metavar="VX,VY",
            help="Of the vehicle at the radar, forward and to the left [m/s]; by default what the data say, else what "
            "a frame shows. For likes-view-ego, and for 'moving' of --points.",
        ),
    ] = None,
    mounting_yaw: Annotated[
        float, typer.Option(help="By how much the radar is turned to the left on the vehicle [degree].")
    ] = 0.0,
) -> None:
    """Image frames with a trained network or a classical estimator, every Doppler peak of a range bin included."""
    from trainer.run.predict import PredictRequest
    from trainer.run.predict import predict as run_predict
    from trainer.run.predictor import PointsRequest
    from trainer.run.pretrained import pretrained_run

    if pretrained and method:
        raise InputError("--method", f"{method!r} beside --pretrained {pretrained}", "one of both")
    expected = 1 if pretrained or method else 2
    if len(paths) != expected:
        raise InputError(
            "arguments", f"{len(paths)} paths", "INPUT alone with --pretrained or --method, else RUN INPUT"
        )
    request = PredictRequest(
        paths[-1], out, run=None if method else pretrained_run(pretrained) if pretrained else Path(paths[0]),
        method=method, radar=radar, split=split, pictures=pictures, points=points, points_format=points_format,
        listed=PointsRequest(false_alarms, cells),
        animation=animation, velocity=None if velocity is None else _velocity(velocity), mounting_yaw_deg=mounting_yaw,
    )  # fmt: skip
    try:
        run_predict(request)
    except KeyboardInterrupt:
        # Pictures of the frames imaged so far may stand in the folder, which has to be empty.
        raise Interrupted(", into a new or emptied --out") from None


def _velocity(text: str) -> tuple[float, float]:
    try:
        forward, left = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--velocity", repr(text), "two numbers [m/s], e.g. 8.3,0") from None
    return forward, left


def export(
    run: Annotated[Path, typer.Argument(help="Run folder of trainer fit.")],
    out: Annotated[Path, typer.Option(help="File to write, ending in .onnx.")],
) -> None:
    """Write a run's network as ONNX, checked against torch."""
    try:
        from trainer.run.export import export as run_export
    except ModuleNotFoundError as error:
        if error.name not in ("onnx", "onnxruntime"):
            raise
        raise InputError("trainer export", f"the package {error.name} is not installed", EXTRA) from error

    result = run_export(run, out)
    print(
        f"{result.path}: within {result.difference:.1e} of torch; one image takes {1e3 * result.torch_seconds:.0f} ms "
        f"in torch, {1e3 * result.onnx_seconds:.0f} ms in onnxruntime"
    )
