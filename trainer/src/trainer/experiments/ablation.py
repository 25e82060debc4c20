"""The comparison behind the defaults: one change at a time, the same data, order and number of steps.

    python -m trainer.experiments.ablation DATASET [DATASET ...] --out DIR [--steps N] [--variants NAME,NAME]

Each variant is an ordinary run folder in DIR, kept if it is there already and gone on with if it was not finished; the
table goes to DIR/ablation.md.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from torch.utils.flop_counter import FlopCounterMode

from shared.errors import InputError
from trainer.configuration import FitConfig
from trainer.fit import fit
from trainer.imager import Imager
from trainer.runs import METRICS, RUN_FILE, load_imager
from trainer.verdict import VERDICT

STEPS = 600
VARIANTS: dict[str, dict[str, object]] = {
    "recommended": {},
    "no-points": {"points": 0, "batch": 4},
    "no-augmentation": {"augment": False},
    "foreground-0": {"foreground": 0.0},
    "exponent-1": {"exponent": 1.0},
    "attention-unet": {"model": "attention-unet", "width": 8},
    "paper": {
        "model": "attention-unet", "width": 8, "features": "paper", "target": "paper", "rows": 0, "batch": 1,
        "augment": False, "points": 0, "foreground": 0.0,
    },
}  # fmt: skip
"""What each variant changes of the recommended configuration."""


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
    except KeyboardInterrupt:
        sys.exit("ablation: interrupted; the same command goes on from the last checkpoint")


def table(datasets: Sequence[Path], out: Path, variants: Sequence[str], steps: int, precision: str) -> str:
    """The Markdown table of the variants, trained where they are not there yet."""
    if unknown := [name for name in variants if name not in VARIANTS]:
        raise InputError("--variants", repr(unknown[0]), f"some of {', '.join(VARIANTS)}")
    head = ["variant", "parameters", "GFLOP", "validation NMSE", "test NMSE", "test F1"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name in variants:
        if not (out / name / VERDICT).is_file():
            config = FitConfig.model_validate({"steps": steps, "precision": precision, **VARIANTS[name]})
            fit(datasets, out / name, config, resume=(out / name / RUN_FILE).is_file())
        run, imager = load_imager(out / name)
        scores = json.loads((out / name / VERDICT).read_text(encoding="utf-8"))
        parameters = sum(parameter.numel() for parameter in imager.parameters())
        flops = giga_flops(imager, run.radar.waveform.range_bins)
        cells = [f"{parameters / 1e6:.2f} M", f"{flops:.1f}", f"{best_validation(out / name):.3f}"]
        lines.append("| " + " | ".join([name, *cells, *(f"{scores[k]['network']:.3f}" for k in ("nmse", "f1"))]) + " |")
    # The same frames for all variants: the last one's baselines are everyone's.
    for key, name in (("das", "delay and sum"), ("mean", "mean training image"), ("zero", "zero image")):
        cells = [f"{scores[k][key]:.3f}" if key in scores[k] else "" for k in ("nmse", "f1")]
        lines.append("| " + " | ".join([name, "", "", "", *cells]) + " |")
    text = "\n".join(lines) + "\n"
    (out / "ablation.md").write_text(text, encoding="utf-8")
    return text


def best_validation(run_directory: Path) -> float:
    """Normalised error on the validation frames of the weights that a run kept."""
    with (run_directory / METRICS).open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    return min(float(row["validation_nmse"]) for row in rows)


if __name__ == "__main__":
    main()
