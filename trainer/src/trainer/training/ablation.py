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
from torch.utils.flop_counter import FlopCounterMode

from shared.dataset.writing import write_text
from shared.physics.errors import InputError
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import choose_array
from trainer.data.pairs import Condition, simulate
from trainer.data.shards import ShardDataset
from trainer.metrics.peaks import resolved, strongest_peaks
from trainer.metrics.ranking import pooled
from trainer.run.configuration import FitConfig
from trainer.run.folder import METRICS, RUN_FILE, Run, load_imager
from trainer.run.imager import Imager
from trainer.training.callbacks import LOSS
from trainer.training.fit import fit
from trainer.training.frame_scores import image_and_score, score_network
from trainer.training.recipes import VARIANTS
from trainer.training.verdict import VERDICT

STEPS = 600
PAIRS = (Condition(0.5, 20.0), Condition(0.25, 30.0))
"""Half a resolution cell of the full array apart, and a quarter at a higher signal-to-noise ratio."""
TRIALS = 300
BASELINES = {"das": "delay and sum", "mean": "mean training image", "zero": "zero image", "truth": "truth"}


@dataclass(frozen=True)
class Score:
    """Scores of an imager.

    :param nmse: of the linear image on the validation frames, with the one gain that errs least
    :param average_precision: on the validation frames
    :param resolved: for each of :data:`PAIRS` the share of pairs of which both targets were found
    """

    nmse: float
    average_precision: float
    resolved: tuple[float, ...]


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
    pairs = [f"resolved {pair.separation_cells:g} RL at {pair.snr_db:g} dB" for pair in PAIRS]
    scored = ["validation NMSE", "validation AP", *pairs]
    lines = _head(["variant", "array", "parameters", "GFLOP", *scored, "test NMSE", "test AP"])
    elsewhere = _head(["variant", "trained on", "imaging with", *scored])
    verdicts: list[dict[str, dict[str, float]]] = []
    for array in arrays:
        for name in variants:
            folders = [out / f"{name}-{Path(array).stem}-{seed}" for seed in seeds]
            for folder, seed in zip(folders, seeds, strict=True):
                if not (folder / VERDICT).is_file():
                    changes = {"steps": steps, "precision": precision, "seed": seed, **VARIANTS[name]}
                    config = FitConfig.model_validate(changes)
                    fit(datasets, folder, config, array, resume=(folder / RUN_FILE).is_file())
            verdicts = [json.loads((folder / VERDICT).read_text(encoding="utf-8")) for folder in folders]
            run, imager = load_imager(folders[0])
            scores = [score_run(*load_imager(folder), datasets) for folder in folders]
            parameters = sum(parameter.numel() for parameter in imager.parameters())
            cells = [f"{parameters / 1e6:.2f} M", f"{giga_flops(imager, run.radar.waveform.range_bins):.1f}"]
            cells += [_middle_and_spread([best_validation(folder) for folder in folders]), *_cells(scores)[1:]]
            cells += _test_cells(verdicts, "network")
            lines.append(_line([name, Path(array).stem, *cells]))
            for other in (other for other in arrays if other != array):
                moved = [score_run(run, behind(folder, other), datasets) for folder in folders]
                elsewhere.append(_line([name, Path(array).stem, Path(other).stem, *_cells(moved)]))
        # All variants have the same frames, and so the same baselines.
        for key, name in BASELINES.items():
            lines.append(_line([name, Path(array).stem, *[""] * (2 + len(scored)), *_test_cells(verdicts[:1], key)]))
    text = "\n".join(lines) + "\n"
    if len(arrays) > 1:
        text += "\n" + "\n".join(elsewhere) + "\n"
    write_text(out / "ablation.md", text)
    return text


def best_validation(run_directory: Path) -> float:
    """Normalised error on the validation frames of the weights that a run kept, those of the least loss."""
    with (run_directory / METRICS).open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    return float(min(rows, key=lambda row: float(row[LOSS]))["validation_nmse"])


def behind(run_directory: Path, array: str) -> Imager:
    """The run's network behind another array, named as for ``trainer fit``, than it was trained with."""
    run, trained = load_imager(run_directory)
    imager = Imager(run.config, run.radar, choose_array(array, run.radar))
    imager.network.load_state_dict(trained.network.state_dict())
    imager.gain = trained.gain
    return imager.eval()


def score_run(run: Run, imager: Imager, datasets: Sequence[Path]) -> Score:
    """Scores of a run's imager, or of its network behind another array (:func:`behind`)."""
    cells, projections, energies = [], [], []
    for dataset in datasets:
        frames = ShardDataset(dataset, "validation")
        for index in range(len(frames)):
            frame = frames[index]
            truth = frame["image"].numpy()
            image, of_frame = score_network(imager, run.radar, frame)
            cells.append(of_frame)
            if not truth.any():
                continue
            energy = np.sum(truth * truth, dtype=np.float64)
            projections.append(np.sum(image * truth, dtype=np.float64) / energy)
            energies.append(np.sum(image * image, dtype=np.float64) / energy)
    # The error with the best single gain, as in trainer.training.task.
    error = 1.0 - np.mean(projections) ** 2 / np.mean(energies) if np.any(energies) else 1.0
    return Score(
        nmse=float(error),
        average_precision=pooled(cells).average_precision(),
        resolved=tuple(_resolved(run, imager, pair) for pair in PAIRS),
    )


def _resolved(run: Run, imager: Imager, pair: Condition) -> float:
    trials = simulate(run.radar, pair, TRIALS, [1, 20])
    noise = torch.tensor(cell_noise_power(run.radar), dtype=torch.float64)
    scores = [image_and_score(imager, torch.from_numpy(snapshot), noise)[1] for snapshot in trials.snapshots]
    rows = np.concatenate([score[trials.rows] for score in scores])
    return float(resolved(strongest_peaks(rows, run.radar.grid.u, 2), trials.u).mean())


def _cells(scores: Sequence[Score]) -> list[str]:
    values = [(score.nmse, score.average_precision, *score.resolved) for score in scores]
    return [_middle_and_spread(of_seeds) for of_seeds in zip(*values, strict=True)]


def _test_cells(verdicts: Sequence[dict[str, dict[str, float]]], method: str) -> list[str]:
    """NMSE and average precision on the test frames, empty where they are not defined."""
    found = [[verdict[key].get(method) for verdict in verdicts] for key in ("nmse", "average_precision")]
    known = [[value for value in of_seeds if value is not None] for of_seeds in found]
    return [_middle_and_spread(of_seeds) if of_seeds else "" for of_seeds in known]


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
