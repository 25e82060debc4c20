"""Scores of a finished run: its network against baselines that need no training, on frames that no choice used.

The test split is imaged by the network, by delay-and-sum of the same channels, by nothing (zero) and by the mean of the
training images. Two numbers each:

- NMSE = sum |estimate - truth|^2 / sum |truth|^2 of the linear image, the mean over frames. The network's image counts
  as it comes out, in sqrt(W) with the one gain that the validation frames gave the run; the others are helped by the
  best factor for each frame.
- Average precision of the detections, all frames in one ranking (:mod:`trainer.metrics.cells`,
  :mod:`trainer.metrics.ranking`). No threshold is chosen. The truth as an estimate of itself says what is possible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from shared.dataset.folder import open_dataset
from shared.dataset.locations import Location, folder_name, locate
from shared.dataset.reading import radar_of
from shared.dataset.writing import write_json
from trainer.data.shards import ShardDataset
from trainer.metrics.cells import CellScores, score_cells
from trainer.metrics.image import nmse, nmse_best_scaled
from trainer.metrics.ranking import pooled
from trainer.run.answers import Answer, network_answer
from trainer.run.folder import load_imager, same_radar
from trainer.run.pictures import save_comparison
from trainer.run.targets import AMPLITUDE, PROBABILITY

Image = NDArray[np.float32]

VERDICT = "verdict.json"
PICTURE = "pictures/test.png"
MOST_FRAMES = 64
"""Frames of a dataset's split that are looked at, evenly spaced: a large dataset's end must not take hours."""
SHOWN = 3
"""Frames in the picture: those with the most truth cells."""

METHODS = ("network", "das", "zero", "mean")
"""Of which there is an NMSE."""
DETECTORS = ("network", "das", "truth")
"""Of which there is an average precision."""


@dataclass(frozen=True)
class Verdict:
    """Scores on the test split.

    :param frames: with a truth
    :param empty_frames: whose truth is zero: they have no NMSE, and all that is detected in them is false
    :param gain: of the network's linear image, from the validation frames
    :param nmse: by method; empty for a run whose image has no amplitudes
    :param average_precision: by method, the truth among them; empty if no frame has a truth cell
    """

    frames: int
    empty_frames: int
    gain: float
    nmse: dict[str, float]
    average_precision: dict[str, float]

    def table(self) -> str:
        """The scores as lines of text."""
        names = {
            "network": "network", "das": "delay and sum", "zero": "zero image", "mean": "mean training image",
            "truth": "truth",
        }  # fmt: skip
        lines = [f"{f'test split, {self.frames} frames':<24} {'NMSE':>8}  average precision"]
        for key, name in names.items():
            cells = [f"{scores[key]:.3f}" if key in scores else "-" for scores in (self.nmse, self.average_precision)]
            lines.append(f"  {name:<22} {cells[0]:>8} {cells[1]:>18}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class _Scored:
    """One frame: the truth and each method's image, all relative to the truth's peak; what became of detections."""

    name: str
    truth: Image
    images: dict[str, Image]
    cells: dict[str, CellScores]


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
    errors: list[list[float]] = []
    cells: dict[str, list[CellScores]] = {name: [] for name in DETECTORS}
    shown: list[_Scored] = []
    answer = network_answer(run, imager)
    for frame in _test_frames(answer, folders, _mean_image(folders, run.config.frames)):
        for name, so_far in cells.items():
            so_far.append(frame.cells[name])
        if frame.truth.any():
            errors.append(_errors(frame))
            shown = sorted([*shown, frame], key=lambda one: -one.cells["truth"].truths)[:SHOWN]
    if not errors:
        announce("no test frames with a truth: no verdict")
        return None
    rankings = {name: pooled(of_method) for name, of_method in cells.items()}
    of_amplitude = answer.unit != PROBABILITY
    error = dict(zip(METHODS, np.mean(errors, axis=0).tolist(), strict=True)) if of_amplitude else {}
    verdict = Verdict(
        frames=len(errors),
        empty_frames=len(cells["truth"]) - len(errors),
        gain=imager.gain,
        nmse=error,
        average_precision={name: found.average_precision() for name, found in rankings.items() if found.defined},
    )
    write_json(run_directory / VERDICT, asdict(verdict), sort_keys=False)
    rows = {
        frame.name: {f"delay and sum, {run.array.name}": frame.images["das"], run.config.model: frame.images["network"],
                     "truth": frame.truth}
        for frame in shown
    }  # fmt: skip
    (run_directory / PICTURE).parent.mkdir(exist_ok=True)
    save_comparison(run_directory / PICTURE, rows, run.radar)
    announce(verdict.table())
    return verdict


def _errors(frame: _Scored) -> list[float]:
    """NMSE of each of :data:`METHODS`; all but the network with the best factor for the frame."""
    images, truth = frame.images, frame.truth
    scaled = [nmse_best_scaled(images[name], truth) for name in ("das", "mean")]
    return [nmse(images["network"], truth), scaled[0], 1.0, scaled[1]]


def _mean_image(folders: Sequence[Location], first: int) -> Image:
    """[R, U] mean of the training truths, each relative to its peak; at most :data:`MOST_FRAMES` of each dataset.

    :param first: the run trained with the frames whose index is below it; 0 for all
    """
    images = []
    for folder in folders:
        frames = ShardDataset(folder, "train", ("image",), first=first)
        images += [frames[index]["image"].numpy() for index in _evenly_spaced(len(frames))]
    return np.asarray(np.mean(images, axis=0), dtype=np.float32)


def _test_frames(answer: Answer, folders: Sequence[Location], mean: Image) -> Iterator[_Scored]:
    for folder in folders:
        if "test" not in open_dataset(folder, check_sizes=False).splits:
            continue
        frames = ShardDataset(folder, "test")
        for index in _evenly_spaced(len(frames)):
            frame = {key: value.numpy() for key, value in frames[index].items()}
            yield _scored(f"{folder_name(folder)}, frame {int(frame['frame_id'])}", answer, frame, mean)


def _scored(name: str, answer: Answer, frame: Mapping[str, NDArray[Any]], mean: Image) -> _Scored:
    range_channel, noise, peak = frame["range_channel"][0], float(frame["noise_power"]), float(frame["image_peak"])
    truth = frame["image"].astype(np.float64) * peak
    das, seen = answer.das(range_channel[None])[0], answer.image_and_score(range_channel, noise)
    cells = {
        kind: score_cells(truth, level, noise, len(answer.channels), answer.radar.waveform.range_step_m)
        for kind, level in (("das", das), ("truth", truth))
    }
    cells["network"] = answer.score_cells(truth, range_channel, noise, seen)
    # Amplitudes relative to the truth's peak, as the truth is; as they are where the truth is zero.
    scale = np.float32(peak or 1.0)
    network = seen[0].astype(np.float32)
    images = {"network": network / scale if answer.unit == AMPLITUDE else network, "das": das / scale, "mean": mean}
    return _Scored(name, frame["image"], images, cells)


def _evenly_spaced(frames: int) -> list[int]:
    """At most :data:`MOST_FRAMES` indices, evenly spaced over all."""
    return sorted({int(index) for index in np.linspace(0, frames - 1, min(frames, MOST_FRAMES))})
