"""Scores of a finished run: its network against what it began with and what needs no training, on frames that no choice
used.

Each method of :data:`NAMES` images the test split. Two numbers each:

- NMSE = sum |estimate - truth|^2 / sum |truth|^2 of the linear image, the mean over frames. A network's image counts
  as it comes out, in sqrt(W) with the one gain that the validation frames gave the run; the others are helped by the
  best factor for each frame.
- Average precision of the detections, all frames in one ranking (:mod:`trainer.metrics.cells`). No
  threshold is chosen. All methods are asked for the cells that the network's channels can see. The truth as an estimate
  of itself says what is possible.

And of the network less each other method the difference of both, with the interval that frames drawn again for the two
together give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.dataset.folder import open_dataset
from shared.dataset.locations import Location, folder_name, locate
from shared.dataset.reading import radar_of
from shared.dataset.writing import write_json
from trainer.data.arrays import choose_array
from trainer.data.dataset import ShardDataset
from trainer.data.measurements import known_world
from trainer.metrics.bootstrap import Interval, bootstrap_mean
from trainer.metrics.cells import CellScores, average_precision, pooled, score_cells
from trainer.metrics.image import nmse, nmse_best_scaled
from trainer.run.answers import Answer, array_answer, network_answer
from trainer.run.folder import Run, Validation, load_imager, read_run, read_validations, same_radar
from trainer.run.imager import AMPLITUDE, PROBABILITY, Imager
from trainer.run.pictures import save_comparison
from trainer.training.start import begin_with, new_imager

Image = NDArray[np.float32]

VERDICT = "verdict.json"
PICTURE = "pictures/test.png"
MOST_FRAMES = 64
"""Frames of a dataset's split that are looked at, evenly spaced: a large dataset's end must not take hours."""
LEAST_FRAMES = 6
"""Of n frames all stand on one side of the median with probability 2^(1 - n): 6 % of five, more than a 95 % interval
leaves."""
UNTOLD = "Whether training helped cannot be said of so few frames"
UNIMPROVED = (
    "Training did not help: no step had a lower validation loss than the weights before training, which are kept"
)
SHOWN = 3
"""Frames in the picture: those with the most truth cells."""

DAS, VIEW, START, UNTRAINED, NETWORK, EVERY, TRUTH = (
    "das", "iaa-view", "start", "untrained", "network", "full", "truth",
)  # fmt: skip
NAMES = {
    DAS: "delay and sum",
    VIEW: "untrained view",
    "likes-view": "untrained view, LIKES",
    START: "network it started from",
    UNTRAINED: "network before training",
    NETWORK: "network",
    EVERY: "untrained view, all RX",
    TRUTH: "truth",
}
"""By the name of a method in ``verdict.json``, in the table's order. A network began as one of two: that of another
run, or what its random weights make of it, which is near the untrained view and is not it.
"""
BEGUN = (START, UNTRAINED)
VIEWS = (VIEW, "likes-view")
"""Estimators of what the virtual sensor would see, the best last: that one is shown all channels."""


@dataclass(frozen=True)
class Verdict:
    """Scores on the test split, by method; no network's NMSE if its image has no amplitudes.

    :param frames: with a truth
    :param empty_frames: whose truth is zero: they have no NMSE, and all that is detected in them is false
    :param gain: of the network's linear image, from the validation frames
    :param nmse: the truth has none
    :param average_precision: empty if no frame has a truth cell
    :param nmse_over: the network's less that of another method; none of a single frame, which has no interval
    :param average_precision_over: the same
    :param step: optimiser steps that the scored weights have seen
    """

    frames: int
    empty_frames: int
    gain: float
    nmse: dict[str, float]
    average_precision: dict[str, float]
    nmse_over: dict[str, Interval]
    average_precision_over: dict[str, Interval]
    step: int

    def table(self) -> str:
        """The scores as lines of text."""
        lines = [f"{f'test split, {self.frames} frames':<26} {'NMSE':>6} {'the network less it':>25}"
                 f" {'average precision':>18} {'the network less it':>25}"]  # fmt: skip
        for key, name in NAMES.items():
            if key not in self.nmse and key not in self.average_precision:
                continue
            line = f"  {name:<24}"
            for scores, over, width in (
                (self.nmse, self.nmse_over, 6), (self.average_precision, self.average_precision_over, 18),
            ):  # fmt: skip
                score = f"{scores[key]:.3f}" if key in scores else "-"
                less = self._told(over[key]) if key in over else ""
                line += f" {score:>{width}} {less:>25}"
            lines.append(line.rstrip())
        return "\n".join(lines)

    def sentence(self) -> str:
        """Whether training helped, by the intervals of both differences to what it began with."""
        if self.step == 0:
            return f"{UNIMPROVED}."
        begun = START if START in {*self.nmse, *self.average_precision} else UNTRAINED
        told, signs = [], []
        for name, over, better in (("average precision", self.average_precision_over, 1), ("NMSE", self.nmse_over, -1)):
            if begun in over:
                told.append(f"{name} {self._told(over[begun])}")
                signs.append(better * (int(over[begun].low > 0.0) - int(over[begun].high < 0.0)))
        if not told:
            return f"{UNTOLD}."
        figures = f"{', '.join(told)} over the {NAMES[begun]}."
        if self.frames < LEAST_FRAMES:
            return f"{UNTOLD}: {figures}"
        said = {
            (True, False): "Training helped",
            (False, True): "Training harmed",
            (True, True): "Training helped one and harmed the other",
            (False, False): "These frames do not show that training helped",
        }[1 in signs, -1 in signs]
        return f"{said}: {figures}"

    def _told(self, difference: Interval) -> str:
        """With its interval, where there are frames enough for one."""
        ends = f" ({difference.low:+.3f} to {difference.high:+.3f})" if self.frames >= LEAST_FRAMES else ""
        return f"{difference.value:+.3f}{ends}"


@dataclass(frozen=True, eq=False)
class _Scored:
    """One frame: the truth and each method's image, all relative to the truth's peak; what became of detections.

    :param errors: NMSE of each method; empty where the truth is zero
    """

    name: str
    truth: Image
    images: dict[str, Image]
    errors: dict[str, float]
    cells: dict[str, CellScores]


def judge(
    run_directory: Path,
    datasets: Sequence[Location | str],
    announce: Callable[[str], object] = print,
    start: Path | None = None,
) -> Verdict | None:
    """Score a run on its datasets' test frames; writes ``verdict.json`` and ``pictures/test.png`` into its folder.

    :param datasets: those of the run; the ones without a test split do not count
    :param start: the run whose weights it began with
    :returns: None if there is nothing to score: no test frames, or a truth that is zero in all of them
    :raises InputError: no whole run, datasets that cannot be read or of another radar
    """
    run, imager = load_imager(run_directory)
    folders = [locate(directory) for directory in datasets]
    for folder in folders:
        same_radar(run.radar, str(run_directory), radar_of(open_dataset(folder).description(), folder), str(folder))
    validations = read_validations(run_directory)
    answers = _answers(run, imager, start, validations[0])
    errors: list[dict[str, float]] = []
    cells: dict[str, list[CellScores]] = {name: [] for name in (*answers, TRUTH)}
    shown: list[_Scored] = []
    for frame in _test_frames(answers, folders):
        for name, so_far in cells.items():
            so_far.append(frame.cells[name])
        if frame.truth.any():
            errors.append(frame.errors)
            shown = sorted([*shown, frame], key=lambda one: -one.cells[TRUTH].truths)[:SHOWN]
    if not errors:
        announce("no test frames with a truth: no verdict")
        return None
    error = {name: np.array([one[name] for one in errors]) for name in errors[0]}
    rankings = {name: found for name, scored in cells.items() if (found := pooled(scored)).defined}
    others = [name for name in answers if name != NETWORK]
    of_frames = {name: bootstrap_mean(error[NETWORK] - error[name]) for name in others if NETWORK in error}
    of_rankings = {name: average_precision(rankings[NETWORK], rankings[name]) for name in others if rankings}
    verdict = Verdict(
        frames=len(errors),
        empty_frames=len(cells[TRUTH]) - len(errors),
        gain=imager.gain,
        nmse={name: float(values.mean()) for name, values in error.items()},
        average_precision={name: found.average_precision() for name, found in rankings.items()},
        nmse_over=_with_ends(of_frames),
        average_precision_over=_with_ends(of_rankings),
        step=min(validations, key=lambda one: one.loss).step,
    )
    write_json(run_directory / VERDICT, asdict(verdict), sort_keys=False)
    rows = {
        frame.name: {f"delay and sum, {run.array.name}": frame.images[DAS], run.config.model: frame.images[NETWORK],
                     "truth": frame.truth}
        for frame in shown
    }  # fmt: skip
    (run_directory / PICTURE).parent.mkdir(exist_ok=True)
    save_comparison(run_directory / PICTURE, rows, run.radar)
    announce(verdict.table())
    announce(verdict.sentence())
    return verdict


def _with_ends(intervals: Mapping[str, Interval]) -> dict[str, Interval]:
    """Without those of a single frame."""
    return {name: one for name, one in intervals.items() if np.isfinite(one.low)}


def _answers(run: Run, imager: Imager, start: Path | None, first: Validation) -> dict[str, Answer]:
    """The methods, by their names in :data:`NAMES`.

    :param first: before the first step
    """
    full = choose_array("full", run.radar)
    answers: dict[str, Answer] = {name: array_answer(name, run.array, run.radar) for name in (DAS, *VIEWS)}
    answers[NETWORK] = network_answer(run, imager)
    if start is not None:
        # As it was, whether it was told the motion or not.
        config = run.config.model_copy(update={"told": read_run(start).config.told})
        begun = Imager(config, run.radar, run.array)
        begun.gain = begin_with(begun, config, start)
        answers[START] = network_answer(run, begun.eval())
    else:
        untrained = new_imager(run.config, run.radar, run.array)
        untrained.gain = first.gain
        answers[UNTRAINED] = network_answer(run, untrained.eval())
    if run.array.rx != full.rx:
        answers[EVERY] = array_answer(VIEWS[-1], full, run.radar)
    return answers


def _test_frames(answers: Mapping[str, Answer], folders: Sequence[Location]) -> Iterator[_Scored]:
    for folder in folders:
        if "test" not in open_dataset(folder, check_sizes=False).splits:
            continue
        frames = ShardDataset(folder, "test", ("range_channel", "velocity", "image"))
        for index in sorted({int(index) for index in np.linspace(0, len(frames) - 1, min(len(frames), MOST_FRAMES))}):
            frame = {key: value.numpy() for key, value in frames[index].items()}
            yield _scored(f"{folder_name(folder)}, frame {int(frame['frame_id'])}", answers, frame)


def _scored(name: str, answers: Mapping[str, Answer], frame: Mapping[str, NDArray[Any]]) -> _Scored:
    range_channel, noise, peak = frame["range_channel"][0], float(frame["noise_power"]), float(frame["image_peak"])
    truth = frame["image"].astype(np.float64) * peak
    network = answers[NETWORK]
    world = known_world(frame, network.radar)[0]
    channels = len(network.channels)
    cells = {TRUTH: score_cells(truth, truth, noise, channels, network.radar.waveform.range_step_m)}
    images: dict[str, Image] = {}
    errors: dict[str, float] = {}
    for method, answer in answers.items():
        image, cells[method] = answer.scored(truth, range_channel, noise, world, channels)
        # Amplitudes relative to the truth's peak, as the truth is; as they are where the truth is zero.
        scale = np.float32(peak or 1.0) if answer.unit == AMPLITUDE else np.float32(1.0)
        images[method] = image.astype(np.float32) / scale
        if truth.any() and answer.unit != PROBABILITY:
            error = nmse if method in (NETWORK, *BEGUN) else nmse_best_scaled
            errors[method] = error(images[method], frame["image"])
    return _Scored(name, frame["image"], images, errors, cells)
