"""``trainer``: the command line. Thin: parse, call the library, print."""

from __future__ import annotations

from shared.cli.application import application
from shared.cli.ending import Ending, run_app
from trainer.cli.captures import calibrate, import_
from trainer.cli.evaluate import evaluate
from trainer.cli.fit import fit
from trainer.cli.predict import export, predict
from trainer.errors import TrainingStopped, out_of_memory

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
    if isinstance(error, TrainingStopped):
        return str(error), 1
    if isinstance(error, (MemoryError, RuntimeError)) and out_of_memory(error):
        reason = (str(error).strip().splitlines() or ["out of memory"])[0]
        return f"{reason}; expected a smaller --batch, --rows, --points or --width, or fewer --workers", 1
    return None
