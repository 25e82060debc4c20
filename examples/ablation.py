"""One change of the network at a time, on the same data, in the same order, for as many steps.

``python examples/ablation.py DATASET VARIANT [VARIANT ...]`` trains each variant that is not there yet and holds all
against each other in build/examples/ablation/evaluation: summary.md has their average precision, NMSE and resolution.
Killed, it goes on with the same command.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from trainer import evaluate, fit
from trainer.run.configuration import FitConfig
from trainer.run.folder import RUN_FILE
from trainer.training.verdict import VERDICT

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "ablation"
ARRAY = os.environ.get("EXAMPLES_ARRAY", "sparse6")
STEPS = int(os.environ.get("EXAMPLES_STEPS", "300"))
TRIALS = int(os.environ.get("EXAMPLES_TRIALS", "120"))

SPECTRAL = {"model": "spectral-unet"}
ATTENTION = {"model": "attention-unet", "width": 8}
VARIANTS: dict[str, dict[str, object]] = {
    "recommended": {},
    "plain-iterations": {"iterations": 8, "learned": 0},
    "no-detection": {"detection": 0.0},
    # What stands below a U-Net was decided before there was the unrolled network.
    "spectral-unet": {**SPECTRAL},
    "attention-unet": {**ATTENTION},
    "no-points": {**SPECTRAL, "points": 0, "batch": 4},
    "no-augmentation": {**SPECTRAL, "augment": False},
    "foreground-0": {**SPECTRAL, "foreground": 0.0},
    "exponent-1": {**SPECTRAL, "exponent": 1.0},
    "paper": {
        **ATTENTION, "features": "paper", "target": "paper", "rows": 0, "batch": 1, "augment": False, "points": 0,
        "foreground": 0.0,
    },
}  # fmt: skip
"""What each changes of the recommended configuration."""


def main() -> None:
    """Train, then compare."""
    dataset, *names = sys.argv[1:]
    runs = [OUT / name for name in names or VARIANTS]
    for run in runs:
        if not (run / VERDICT).is_file():
            changed = FitConfig.model_validate({"steps": STEPS, **VARIANTS[run.name]})
            fit([dataset], run, config=changed, array=ARRAY, start=None, resume=(run / RUN_FILE).is_file())
    evaluate(
        dataset, out=OUT / "evaluation", run=runs, methods=("das", "unet"), arrays=ARRAY,
        experiments=("detection", "resolution"), trials=TRIALS, resume=(OUT / "evaluation").is_dir(), announce=print,
    )  # fmt: skip
    print((OUT / "evaluation" / "summary.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
