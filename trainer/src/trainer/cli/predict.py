"""``trainer predict`` and ``trainer export``: what a run is used for."""

from __future__ import annotations

from shared.cli.console import plain_console
from shared.cli.ending import Interrupted
from shared.cli.options import asking
from shared.physics.errors import InputError
from trainer.run.options import ExportOptions, PredictRequest

EXTRA = "pip install 'sparseradar-trainer[export]'"


@asking(PredictRequest)
def predict(asked: PredictRequest) -> None:
    """Image frames with a trained network or a classical estimator, every Doppler peak of a range bin included."""
    from trainer.run.predict import predict as run_predict

    try:
        run_predict(**{**vars(asked), "announce": plain_console().print})
    except KeyboardInterrupt:
        # Pictures of the frames imaged so far may stand in the folder, which has to be empty.
        raise Interrupted(", into a new or emptied --out") from None


@asking(ExportOptions)
def export(asked: ExportOptions) -> None:
    """Write a run's network as ONNX, checked against torch."""
    try:
        from trainer.run.export import export as run_export
    except ModuleNotFoundError as error:
        if error.name not in ("onnx", "onnxruntime"):
            raise
        raise InputError("trainer export", f"the package {error.name} is not installed", EXTRA) from error

    result = run_export(**vars(asked))
    print(
        f"{result.path}: within {result.difference:.1e} of torch; one image takes {1e3 * result.torch_seconds:.0f} ms "
        f"in torch, {1e3 * result.onnx_seconds:.0f} ms in onnxruntime"
    )
