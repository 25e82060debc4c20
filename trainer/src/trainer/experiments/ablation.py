"""The comparison behind the defaults: one change at a time, the same data, order and number of steps.

    python -m trainer.experiments.ablation DATASET [DATASET ...] --out DIR [--steps N] [--variants NAME,NAME]

Each variant is an ordinary run folder in DIR, kept if it is there already; the table goes to DIR/ablation.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from shared.errors import InputError
from trainer.configuration import FitConfig
from trainer.data import ShardDataset
from trainer.fit import fit
from trainer.imager import Imager
from trainer.runs import WEIGHTS, load_imager
from trainer.task import best_scaled, normalised_error

STEPS = 500
VARIANTS: dict[str, dict[str, object]] = {
    "recommended": {},
    "foreground-0": {"foreground": 0.0},
    "foreground-4": {"foreground": 4.0},
    "exponent-0.75": {"exponent": 0.75, "foreground": 0.0},
    "exponent-1": {"exponent": 1.0},
    "no-augmentation": {"augment": False},
    "attention-unet": {"model": "attention-unet", "width": 8},
    "paper-input-target": {"features": "paper", "target": "paper", "rows": 0, "augment": False, "foreground": 0.0},
}
"""What each variant changes of the recommended configuration."""


@dataclass(frozen=True)
class Score:
    """Means over the test frames of one dataset.

    :param error: normalised squared error of the estimate as it is
    :param scaled_error: of the estimate with the best factor for each frame
    :param das_error: of delay-and-sum of the same channels with the best factor
    :param mean_error: of the mean training image with the best factor; an all-zero image has 1
    """

    error: float
    scaled_error: float
    das_error: float
    mean_error: float


def score(imager: Imager, dataset: Path) -> Score:
    """Test frames of one dataset, against the truth relative to its peak; frames without a truth do not count."""
    training, frames = ShardDataset(dataset, "train", ("image",)), ShardDataset(dataset, "test")
    mean = torch.stack([training[index]["image"] for index in range(len(training))]).mean(dim=0)[None]
    errors = []
    for index in range(len(frames)):
        frame = frames[index]
        truth, snapshot = frame["image"][None], frame["range_channel"][:1]
        if not truth.any():
            continue
        with torch.inference_mode():
            estimate = imager(snapshot, frame["noise_power"][None])
        if imager.config.target == "row":
            estimate = estimate / frame["image_peak"].float()
        candidates = (estimate, *(best_scaled(image, truth) for image in (estimate, imager.das(snapshot), mean)))
        errors.append([float(normalised_error(candidate, truth)) for candidate in candidates])
    return Score(*np.mean(errors, axis=0).tolist())


def giga_flops(imager: Imager, rows: int) -> float:
    """Floating-point operations of one image's network pass, in 1e9; a multiply-add counts two."""
    snapshot = torch.zeros(1, rows, int(imager.channels.max()) + 1, dtype=torch.complex64)
    features, _ = imager.features(snapshot, torch.ones(1))
    with torch.inference_mode(), FlopCounterMode(display=False) as counter:
        imager.network(features)
    return counter.get_total_flops() / 1e9


def main(arguments: Sequence[str] | None = None) -> None:
    """Train the variants that are not there yet, score all, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--precision", choices=("32", "bf16"), default="bf16")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    options = parser.parse_args(arguments)
    try:
        print(table(options.datasets, options.out, options.variants.split(","), options.steps, options.precision))
    except InputError as error:
        sys.exit(f"ablation: {error}")


def table(datasets: Sequence[Path], out: Path, variants: Sequence[str], steps: int, precision: str) -> str:
    """The Markdown table of the variants, trained where they are not there yet."""
    if unknown := [name for name in variants if name not in VARIANTS]:
        raise InputError("--variants", repr(unknown[0]), f"some of {', '.join(VARIANTS)}")
    names = [path.resolve().name for path in datasets]
    head = ["variant", "parameters", "GFLOP", *(f"{name}: error / scaled" for name in names)]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    baselines = ""
    for name in variants:
        if not (out / name / WEIGHTS).is_file():
            config = FitConfig.model_validate({"steps": steps, "precision": precision, **VARIANTS[name]})
            fit(datasets, out / name, config)
        run, imager = load_imager(out / name)
        scores = [score(imager, dataset) for dataset in datasets]
        parameters = sum(parameter.numel() for parameter in imager.parameters())
        flops = giga_flops(imager, run.radar.waveform.range_bins)
        cells = [f"{s.error:.2f} / {s.scaled_error:.2f}" for s in scores]
        lines.append("| " + " | ".join([name, f"{parameters / 1e6:.2f} M", f"{flops:.1f}", *cells]) + " |")
        shown = [f"{s.das_error:.2f} / {s.mean_error:.2f}" for s in scores]
        baselines = "| " + " | ".join(["delay-and-sum / mean training image, scaled", "", "", *shown]) + " |"
    text = "\n".join([*lines, baselines]) + "\n"
    (out / "ablation.md").write_text(text, encoding="utf-8")
    return text


if __name__ == "__main__":
    main()
