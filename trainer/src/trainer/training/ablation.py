"""The comparison behind the defaults: one change at a time, the same data, order and number of steps.

    python -m trainer.training.ablation DATASET [DATASET ...] --out DIR [--steps N] [--variants NAME,NAME]
        [--arrays NAME,NAME] [--seeds K,K]

Each variant is an ordinary run folder in DIR, kept if it is there already and gone on with if it was not finished; the
tables go to DIR/ablation.md. The second says what the same weights are worth behind another array than they were
trained with.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.flop_counter import FlopCounterMode

from shared.dataset.writing import write_text
from shared.physics.errors import InputError
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import choose_array
from trainer.data.pairs import Condition, simulate
from trainer.data.shards import ShardDataset
from trainer.metrics.detection import Counts
from trainer.metrics.resolution import resolved, strongest_peaks
from trainer.run.configuration import FitConfig
from trainer.run.folder import METRICS, RUN_FILE, Run, load_imager
from trainer.run.imager import Imager
from trainer.run.targets import AMPLITUDE, UNITS
from trainer.training.fit import fit
from trainer.training.recipes import VARIANTS
from trainer.training.verdict import THRESHOLDS_DB, TRUTH_DB, VERDICT, count_matches, row_peaks

STEPS = 600
PAIR = (0.5, 20.0)
"""Separation in resolution cells of the full array, and signal-to-noise ratio of a channel [dB], of the pairs."""
TRIALS = 300


@dataclass(frozen=True)
class Score:
    """Scores of an imager.

    :param nmse: of the linear image on the validation frames, with the one gain that errs least
    :param f1: on the validation frames, at the best level (:mod:`trainer.training.verdict`)
    :param resolved: share of the pairs of :data:`PAIR` of which both targets were found
    """

    nmse: float
    f1: float
    resolved: float


def giga_flops(imager: Imager, rows: int) -> float:
    """Floating-point operations of one image's network pass, in 1e9; a multiply-add counts two."""
    snapshot = torch.zeros(1, rows, int(imager.channels.max()) + 1, dtype=torch.complex64)
    features, _ = imager.features(snapshot, torch.ones(1))
    with torch.inference_mode(), FlopCounterMode(display=False) as counter:
        imager.network(features)
    return counter.get_total_flops() / 1e9


def main(arguments: Sequence[str] | None = None) -> None:
    """Train the variants that are not there yet, score all, write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--precision", choices=("32", "bf16"), default="bf16")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    parser.add_argument("--arrays", default="sparse6")
    parser.add_argument("--seeds", default="0")
    given = parser.parse_args(arguments)
    variants, arrays = given.variants.split(","), given.arrays.split(",")
    try:
        if not all(seed.isdecimal() for seed in given.seeds.split(",")):
            raise InputError("--seeds", repr(given.seeds), "whole numbers from 0 on, between commas")
        seeds = [int(seed) for seed in given.seeds.split(",")]
        print(table(given.datasets, given.out, variants, given.steps, given.precision, arrays, seeds))
    except InputError as error:
        sys.exit(f"ablation: {error}")
    except KeyboardInterrupt:
        sys.exit("ablation: interrupted; the same command goes on from the last checkpoint")


def table(
    datasets: Sequence[Path],
    out: Path,
    variants: Sequence[str],
    steps: int,
    precision: str,
    arrays: Sequence[str] = ("sparse6",),
    seeds: Sequence[int] = (0,),
) -> str:
    """The Markdown tables of the variants, trained where they are not there yet.

    :raises InputError: a variant that does not exist, and whatever :func:`trainer.training.fit.fit` refuses
    """
    if unknown := [name for name in variants if name not in VARIANTS]:
        raise InputError("--variants", repr(unknown[0]), f"some of {', '.join(VARIANTS)}")
    head = ["variant", "array", "parameters", "GFLOP", "validation NMSE", "validation F1", "resolved", "test NMSE"]
    lines, elsewhere = _head([*head, "test F1"]), _head(["variant", "trained on", "imaging with", *head[4:7]])
    verdict: dict[str, dict[str, float]] = {}
    for array in arrays:
        for name in variants:
            folders = [out / f"{name}-{Path(array).stem}-{seed}" for seed in seeds]
            for folder, seed in zip(folders, seeds, strict=True):
                if not (folder / VERDICT).is_file():
                    changes = {"steps": steps, "precision": precision, "seed": seed, **VARIANTS[name]}
                    config = FitConfig.model_validate(changes)
                    fit(datasets, folder, config, array, resume=(folder / RUN_FILE).is_file())
            verdicts = [json.loads((folder / VERDICT).read_text(encoding="utf-8")) for folder in folders]
            verdict = verdicts[0]
            run, imager = load_imager(folders[0])
            scores = [_score(*load_imager(folder), datasets) for folder in folders]
            parameters = sum(parameter.numel() for parameter in imager.parameters())
            cells = [f"{parameters / 1e6:.2f} M", f"{giga_flops(imager, run.radar.waveform.range_bins):.1f}"]
            cells += [_middle_and_spread([best_validation(folder) for folder in folders]), *_cells(scores)[1:]]
            cells += [_middle_and_spread([found[key]["network"] for found in verdicts]) for key in ("nmse", "f1")]
            lines.append(_line([name, Path(array).stem, *cells]))
            for other in (other for other in arrays if other != array):
                moved = [_score(run, behind(folder, other), datasets) for folder in folders]
                elsewhere.append(_line([name, Path(array).stem, Path(other).stem, *_cells(moved)]))
        # All variants have the same frames, and so the same baselines.
        for key, name in (("das", "delay and sum"), ("mean", "mean training image"), ("zero", "zero image")):
            cells = [f"{verdict[k][key]:.3f}" if key in verdict[k] else "" for k in ("nmse", "f1")]
            lines.append(_line([name, Path(array).stem, "", "", "", "", "", *cells]))
    text = "\n".join(lines) + "\n"
    if len(arrays) > 1:
        text += "\n" + "\n".join(elsewhere) + "\n"
    write_text(out / "ablation.md", text)
    return text


def best_validation(run_directory: Path) -> float:
    """Normalised error on the validation frames of the weights that a run kept."""
    with (run_directory / METRICS).open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    return min(float(row["validation_nmse"]) for row in rows)


def behind(run_directory: Path, array: str) -> Imager:
    """The run's network behind another array, named as for ``trainer fit``, than it was trained with."""
    run, trained = load_imager(run_directory)
    imager = Imager(run.config, run.radar, choose_array(array, run.radar))
    imager.network.load_state_dict(trained.network.state_dict())
    imager.gain = trained.gain
    return imager.eval()


def _score(run: Run, imager: Imager, datasets: Sequence[Path]) -> Score:
    counts = [Counts()] * len(THRESHOLDS_DB)
    projections, energies = [], []
    for dataset in datasets:
        frames = ShardDataset(dataset, "validation")
        for index in range(len(frames)):
            frame = frames[index]
            truth, peak = frame["image"].numpy(), float(frame["image_peak"])
            if not truth.any():
                continue
            image = _image(imager, frame["range_channel"][0], frame["noise_power"])
            if UNITS[run.config.target] == AMPLITUDE:
                image = image / np.float32(peak)
            found = count_matches(image, row_peaks(truth, TRUTH_DB))
            counts = [one + other for one, other in zip(counts, found, strict=True)]
            energy = np.sum(truth * truth, dtype=np.float64)
            projections.append(np.sum(image * truth, dtype=np.float64) / energy)
            energies.append(np.sum(image * image, dtype=np.float64) / energy)
    # The error with the best single gain, as in trainer.training.task.
    error = 1.0 - np.mean(projections) ** 2 / np.mean(energies) if np.any(energies) else 1.0
    return Score(float(error), max(count.f1 for count in counts), _resolved(run, imager))


def _resolved(run: Run, imager: Imager) -> float:
    trials = simulate(run.radar, Condition(*PAIR), TRIALS, [1, 20])
    noise = torch.tensor(cell_noise_power(run.radar), dtype=torch.float64)
    images = [_image(imager, torch.from_numpy(snapshot), noise)[trials.rows] for snapshot in trials.snapshots]
    found = strongest_peaks(np.concatenate(images), run.radar.grid.u, 2)
    return float(resolved(found, trials.u).mean())


def _image(imager: Imager, snapshot: torch.Tensor, noise_power: torch.Tensor) -> NDArray[np.float32]:
    """[R, U] of one frame [R, C] of all channels."""
    with torch.inference_mode():
        return np.asarray(imager(snapshot[None], noise_power[None])[0].numpy())


def _cells(scores: Sequence[Score]) -> list[str]:
    return [_middle_and_spread([getattr(score, name) for score in scores]) for name in ("nmse", "f1", "resolved")]


def _middle_and_spread(values: Sequence[float]) -> str:
    """The middle between the least and the largest value, and half of their difference."""
    low, high = min(values), max(values)
    middle = f"{0.5 * (low + high):.3f}"
    return middle if len(values) == 1 else f"{middle} ± {0.5 * (high - low):.3f}"


def _head(names: Sequence[str]) -> list[str]:
    return [_line(names), "|" + "---|" * len(names)]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
