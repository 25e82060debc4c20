"""Scores of a finished run: its network against baselines that need no training, on frames that no choice used.

The test split is imaged by the network, by delay-and-sum of the same channels, by nothing (zero) and by the mean of the
training images. Two numbers each:

- NMSE = sum |estimate - truth|^2 / sum |truth|^2 of the linear image, the mean over frames. The network's image counts
  as it comes out, in sqrt(W) with the one gain that the validation frames gave the run; the others are helped by the
  best factor for each frame.
- F1 = 2 TP / (2 TP + FP + FN) over all frames: peaks along u of each range bin, matched one to one with those of the
  truth within :data:`MATCH_BINS` and half the distance to the next (:mod:`trainer.metrics.detection`). Levels are
  amplitude times range below the frame's maximum, as in the pictures. How far below it a peak still counts is each
  method's own best on the validation frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import find_peaks

from shared.dataset.folder import open_dataset
from shared.dataset.locations import Location, folder_name, locate
from shared.dataset.reading import radar_of
from shared.dataset.writing import write_json
from trainer.data.shards import ShardDataset
from trainer.metrics.detection import D_MAX_BINS, Counts, count_one_to_one, total
from trainer.metrics.image import nmse, nmse_best_scaled
from trainer.run.folder import load_imager, same_radar
from trainer.run.imager import Imager
from trainer.run.pictures import range_weighted_db, save_comparison
from trainer.run.targets import AMPLITUDE, PROBABILITY, UNITS

VERDICT = "verdict.json"
PICTURE = "pictures/test.png"
MOST_FRAMES = 64
"""Frames of each split and dataset that are looked at, evenly spaced: a large dataset's end must not take hours."""
SHOWN = 3
"""Frames in the picture: those whose truth has the most peaks."""
MATCH_BINS = D_MAX_BINS[0]
"""Largest distance of a matched peak [angle bins], the smaller of the paper's two."""
PROMINENCE_DB = 3.0
"""Two peaks are two where the level falls this much between them [dB]."""
TRUTH_DB = -30.0
"""A peak of the truth counts down to this level [dB]."""
THRESHOLDS_DB = tuple(float(level) for level in range(-40, -4, 2))
"""Levels down to which an estimate's peaks may count [dB]."""

METHODS = ("network", "das", "zero", "mean")
SCORED = ("validation", "test")

Image = NDArray[np.float32]
RowPeaks = NDArray[np.float64]


@dataclass(frozen=True)
class Verdict:
    """Scores on the test split.

    :param frames: that were scored
    :param empty_frames: whose truth is zero: no score is defined, they do not count
    :param gain: of the network's linear image, from the validation frames
    :param nmse: by method; empty for a run whose image has no amplitudes
    :param f1: by method
    :param threshold_db: level down to which a method's peaks count, from the validation frames
    """

    frames: int
    empty_frames: int
    gain: float
    nmse: dict[str, float]
    f1: dict[str, float]
    threshold_db: dict[str, float]

    def table(self) -> str:
        """The scores as lines of text."""
        names = {"network": "network", "das": "delay and sum", "zero": "zero image", "mean": "mean training image"}
        lines = [f"test split, {self.frames} frames      NMSE  one-to-one F1"]
        for key, name in names.items():
            cells = [f"{scores[key]:.3f}" if key in scores else "-" for scores in (self.nmse, self.f1)]
            lines.append(f"  {name:<20} {cells[0]:>10} {cells[1]:>14}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class _Scored:
    """One frame: the truth and each method's image, all relative to the truth's peak."""

    name: str
    truth: Image
    images: dict[str, Image]


def judge(
    run_directory: Path, datasets: Sequence[Location | str], announce: Callable[[str], object] = print
) -> Verdict | None:
    """Score a run on its datasets' test frames; writes ``verdict.json`` and ``pictures/test.png`` into its folder.

    :param datasets: those of the run; the ones without a test split do not count
    :returns: None if there is nothing to score: no test frames, or a truth that is zero in all of them
    :raises InputError: no whole run, datasets that cannot be read or of another radar
    """
    run, imager = load_imager(run_directory)
    imager.to("cuda" if torch.cuda.is_available() else "cpu")
    folders = [locate(directory) for directory in datasets]
    for folder in folders:
        same_radar(run.radar, str(run_directory), radar_of(open_dataset(folder).description(), folder), str(folder))
    none = [Counts()] * len(THRESHOLDS_DB)
    counts = {split: dict.fromkeys(("network", "das"), none) for split in SCORED}
    errors: list[list[float]] = []
    shown: list[tuple[int, _Scored]] = []
    empty = 0
    mean = _mean_image(folders)
    for split in SCORED:
        for frame in _frames(imager, folders, split, mean):
            if not frame.truth.any():
                empty += split == "test"
                continue
            peaks = row_peaks(frame.truth, TRUTH_DB)
            for name, so_far in counts[split].items():
                found = count_matches(frame.images[name], peaks)
                counts[split][name] = [one + other for one, other in zip(so_far, found, strict=True)]
            if split == "test":
                errors.append(_errors(frame))
                shown = sorted([*shown, (len(peaks), frame)], key=lambda pair: -pair[0])[:SHOWN]
    if not errors:
        announce("no test frames with a truth: no verdict")
        return None
    best = {name: int(np.argmax([c.f1 for c in found])) for name, found in counts["validation"].items()}
    of_amplitude = UNITS[run.config.target] != PROBABILITY
    error = dict(zip(METHODS, np.mean(errors, axis=0).tolist(), strict=True)) if of_amplitude else {}
    verdict = Verdict(
        frames=len(errors),
        empty_frames=empty,
        gain=imager.gain,
        nmse=error,
        f1={name: counts["test"][name][index].f1 for name, index in best.items()},
        threshold_db={name: THRESHOLDS_DB[index] for name, index in best.items()},
    )
    write_json(run_directory / VERDICT, asdict(verdict), sort_keys=False)
    rows = {
        frame.name: {f"delay and sum, {run.array.name}": frame.images["das"], run.config.model: frame.images["network"],
                     "truth": frame.truth}
        for _, frame in shown
    }  # fmt: skip
    (run_directory / PICTURE).parent.mkdir(exist_ok=True)
    save_comparison(run_directory / PICTURE, rows, run.radar)
    announce(verdict.table())
    return verdict


def row_peaks(image: Image, lowest_db: float) -> RowPeaks:
    """[n, 3] range bin, angle bin and level [dB] of the peaks along u of each range bin, down to ``lowest_db``."""
    level = range_weighted_db(image, PROMINENCE_DB - lowest_db)
    found = []
    for row in np.flatnonzero(level.max(axis=1) >= lowest_db):
        # The padding makes a maximum at the image's edge a peak too.
        padded = np.pad(level[row], 1, constant_values=lowest_db - PROMINENCE_DB)
        columns = find_peaks(padded, height=lowest_db, prominence=PROMINENCE_DB)[0] - 1
        found.append(np.stack([np.full(len(columns), row), columns, level[row, columns]], axis=1))
    return np.concatenate(found) if found else np.empty((0, 3))


def count_matches(estimate: Image, truth: RowPeaks) -> list[Counts]:
    """Counts of an image against the peaks of its truth, at each of :data:`THRESHOLDS_DB`."""
    peaks = row_peaks(estimate, THRESHOLDS_DB[0])
    rows = np.union1d(peaks[:, 0], truth[:, 0])
    pairs = [(peaks[peaks[:, 0] == row], truth[truth[:, 0] == row, 1]) for row in rows]
    return [
        total(count_one_to_one(found[found[:, 2] >= level, 1], true, MATCH_BINS) for found, true in pairs)
        for level in THRESHOLDS_DB
    ]


def _errors(frame: _Scored) -> list[float]:
    """NMSE of each of :data:`METHODS`; all but the network with the best factor for the frame."""
    images, truth = frame.images, frame.truth
    scaled = [nmse_best_scaled(images[name], truth) for name in ("das", "mean")]
    return [nmse(images["network"], truth), scaled[0], 1.0, scaled[1]]


def _mean_image(folders: Sequence[Location]) -> Image:
    """[R, U] mean of the training truths, each relative to its peak; at most :data:`MOST_FRAMES` of each dataset."""
    images = []
    for folder in folders:
        frames = ShardDataset(folder, "train", ("image",))
        images += [frames[index]["image"].numpy() for index in _evenly_spaced(len(frames))]
    return np.asarray(np.mean(images, axis=0), dtype=np.float32)


def _frames(imager: Imager, folders: Sequence[Location], split: str, mean: Image) -> Iterator[_Scored]:
    device = imager.weights.device
    for folder in folders:
        if split not in open_dataset(folder, check_sizes=False).splits:
            continue
        frames = ShardDataset(folder, split)
        for index in _evenly_spaced(len(frames)):
            frame = frames[index]
            snapshot, noise = frame["range_channel"][:1].to(device), frame["noise_power"][None].to(device)
            peak = float(frame["image_peak"]) or 1.0
            with torch.inference_mode():
                network = np.asarray(imager(snapshot, noise)[0].cpu().numpy(), dtype=np.float32)
                das = np.asarray(imager.das(snapshot)[0].cpu().numpy(), dtype=np.float32)
            if UNITS[imager.config.target] == AMPLITUDE:
                network = network / np.float32(peak)
            images = {"network": network, "das": das / np.float32(peak), "mean": mean}
            yield _Scored(f"{folder_name(folder)}, frame {int(frame['frame_id'])}", frame["image"].numpy(), images)


def _evenly_spaced(frames: int) -> list[int]:
    """At most :data:`MOST_FRAMES` indices, evenly spaced over all."""
    return sorted({int(index) for index in np.linspace(0, frames - 1, min(frames, MOST_FRAMES))})
