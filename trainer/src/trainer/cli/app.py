"""``trainer``: the command line. Thin: parse, call the library, print.

What computes takes seconds to import, and ``--help`` should not: a command imports its function when it runs.
"""

from __future__ import annotations

import shlex
from typing import Any

from shared.cli.application import application
from shared.cli.console import plain_console
from shared.cli.ending import Ending, Interrupted, run_app
from shared.cli.options import asking
from shared.physics.errors import InputError
from shared.processes.telling import AnnouncingOptions
from trainer.captures.options import CalibrateOptions, ImportOptions
from trainer.defaults import TENSORBOARD
from trainer.errors import Stopped, out_of_memory
from trainer.evaluation.options import EvaluateOptions
from trainer.run.options import ExportOptions, PredictRequest
from trainer.training.options import FitRequest

EXAMPLES = {
    "fit": (
        "trainer fit build/mine --out build/run",
        "trainer fit build/mine --array sparse4 --steps 1500 --out build/run-sparse4",
    ),
    "predict": (
        "trainer predict build/mine --pretrained sparse6 --points --out build/images",
        "trainer predict build/run build/mine --out build/images-of-run",
    ),
    "evaluate": (
        "trainer evaluate build/mine --run build/run --out build/report",
        "trainer evaluate build/mine --methods das,music,iaa --arrays sparse6,sparse4 --out build/classical",
    ),
    "export": (
        "trainer export build/run --out build/run.onnx",
        "trainer export build/run-sparse4 --out build/run-sparse4.onnx",
    ),
    "calibrate": (
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 --out calibration.toml",
        "trainer calibrate corner.bin --board iwr1843 --range 5.02 --angle 0 "
        "--check other.bin --check-range 4.1 --check-angle 15 --out checked.toml",
    ),
    "import": (
        "trainer import adc_data.bin --board iwr1843 --out cube.npz",
        "trainer import adc_data.bin --board iwr1843 --calibration calibration.toml --out calibrated.npz",
    ),
}
"""Two of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them.

``build/mine`` is a dataset that ``datafactory render`` made; captures are the reader's own.
"""
STOPPED = "interrupted; the same command with --resume goes on from the last checkpoint"

EXTRA = "pip install 'sparseradar-trainer[export]'"


def _told(asked: AnnouncingOptions) -> dict[str, Any]:
    """What was asked for, with lines for the console."""
    return {**vars(asked), "announce": plain_console().print}


@asking(FitRequest)
def fit(asked: FitRequest) -> None:
    """Train a network on datasets of the factory."""
    from shared.dataset.folder import open_dataset
    from trainer.training.fit import fit as run_fit
    from trainer.training.processes import is_first

    run_fit(**_told(asked))
    if not is_first():
        return
    # The located name is shown: a URI as given may hold a key.
    dataset, run = open_dataset(asked.datasets[0], check_sizes=False), shlex.quote(str(asked.out))
    split = "" if "test" in dataset.splits else " --split all"
    next_command = f"trainer predict {run} {shlex.quote(str(dataset.path))}{split} --out DIR"
    curves = f"curves: tensorboard --logdir {run}; " if asked.logger == TENSORBOARD else ""
    plain_console().print(f"run in {asked.out}; {curves}next: {next_command}")


@asking(PredictRequest)
def predict(asked: PredictRequest) -> None:
    """Image frames with a trained network or a classical estimator, every Doppler peak of a range bin included."""
    from trainer.run.predict import predict as run_predict

    try:
        run_predict(**_told(asked))
    except KeyboardInterrupt:
        # Pictures of the frames imaged so far may stand in the folder, which has to be empty.
        raise Interrupted(", into a new or emptied --out") from None


@asking(EvaluateOptions)
def evaluate(asked: EvaluateOptions) -> None:
    """Hold runs and classical estimators against each other: metrics, figures, and a page to look at."""
    from shared.cli.progress import bars
    from trainer.evaluation.evaluate import evaluate as run_evaluate

    console = plain_console()
    with bars(console) as advance:
        run_evaluate(**{**vars(asked), "announce": console.print, "progress": advance})


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
        f"{result.path}: on noise and on 1 to 4 targets at 20 and 40 dB within {result.difference:.1e} of the network "
        f"in double precision, beside {result.rounding:.1e} of torch; one image takes "
        f"{1e3 * result.torch_seconds:.0f} ms in torch, {1e3 * result.onnx_seconds:.0f} ms in onnxruntime"
    )


@asking(CalibrateOptions)
def calibrate(asked: CalibrateOptions) -> None:
    """Gain, phase and delay of a board's channels from captures of a reflector whose place is known."""
    from trainer.captures.calibrating import calibrate as run_calibrate

    run_calibrate(**_told(asked))


@asking(ImportOptions)
def import_(asked: ImportOptions) -> None:
    """The raw samples of a board as a cube that predict and evaluate read."""
    from trainer.captures.importing import import_capture

    import_capture(**_told(asked))


app = application(
    "trainer",
    "Radar datasets to networks that image sharper than the array.",
    (fit, predict, evaluate, export, calibrate, import_),
    EXAMPLES,
)


def main() -> None:
    """Entry point."""
    run_app("trainer", app, STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    if isinstance(error, Stopped):
        return str(error), 1
    if isinstance(error, (MemoryError, RuntimeError)) and out_of_memory(error):
        reason = (str(error).strip().splitlines() or ["out of memory"])[0]
        return f"{reason}; expected a smaller --batch, --rows, --points or --width, or fewer --workers", 1
    return None
