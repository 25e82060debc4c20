"""Networks and untrained methods beside each other: the tables of docs/notes/ego-motion.md and docs/notes/weights.md.

    python tests/benchmarks/answers.py motion DATASET [sparse6,sparse4,full]
    python tests/benchmarks/answers.py told DATASET PLAIN TOLD
    python tests/benchmarks/answers.py unseen DATASET [RUN...] [--array sparse6]

Frames of the test split at their strongest Doppler peaks; average precision and NMSE with bootstrap intervals over the
frames, paired for differences.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from shared.dataset import Frame
from shared.dataset.folder import MANIFEST, open_dataset
from shared.dataset.reading import radar_of
from shared.radar import Radar
from shared.signal.ego_motion import EgoMotion
from trainer.data.arrays import choose_array
from trainer.data.measurements import Cells, Measurement, known_world
from trainer.metrics.bootstrap import Interval, bootstrap_mean
from trainer.metrics.cells import CellScores, average_precision, pooled
from trainer.metrics.image import nmse
from trainer.run.answers import Answer, NetworkAnswer, array_answer, network_answer
from trainer.run.folder import load_imager, read_run
from trainer.run.pretrained import pretrained_run

VIEWS = ("iaa-view", "likes-view", "likes-view-ego")
MOTION_PAIRS = (
    ("likes-view", "iaa-view"), ("likes-view-ego", "likes-view"), ("network", "likes-view-ego"),
    ("network, told", "network"), ("estimated", "likes-view"),
)  # fmt: skip
TOLD_PAIRS = (
    ("plain", "shipped"), ("told", "plain"), ("plain, told", "plain"), ("told, told", "plain"),
    ("told, told", "plain, told"), ("told, told", "told"), ("told, told", "shipped, told"),
)  # fmt: skip
FULL = "full"

app = typer.Typer(add_completion=False, help=__doc__)


@dataclass(frozen=True)
class Scores:
    """Of one answer: the detections and the NMSE of each frame."""

    cells: list[CellScores]
    errors: NDArray[np.float64]

    def of_frames(self, chosen: NDArray[np.int64]) -> "Scores":
        return Scores([self.cells[i] for i in chosen], self.errors[chosen])

    def intervals(self) -> tuple[Interval, Interval]:
        """Average precision and NMSE."""
        return average_precision(pooled(self.cells)), bootstrap_mean(self.errors)

    def less(self, other: "Scores") -> tuple[Interval, Interval]:
        """The same of the differences, frame by frame."""
        precision = average_precision(pooled(self.cells), pooled(other.cells))
        return precision, bootstrap_mean(self.errors - other.errors)


@app.command()
def motion(dataset: Path, arrays: Annotated[str, typer.Argument()] = "sparse6,sparse4,full") -> None:
    """What the sensor's own motion is worth. ``estimated`` is told the velocity that the frame itself shows; before the
    table stands how far that is from the truth."""
    frames, radar = judged_frames(dataset)
    for array in arrays.split(","):
        answers = untrained(VIEWS, array, radar)
        views = answers["likes-view-ego"]
        if array != FULL:
            answers["network"] = with_share(pretrained_run(array), None)
            answers["network, told"] = with_share(pretrained_run(array), 1.0)
        found = {name: scores(answer, frames, radar) for name, answer in answers.items()}
        found["estimated"] = scores(views, [_estimated(frame, views) for frame in frames], radar)
        print_scores(array, found, [(one, other) for one, other in MOTION_PAIRS if one in found])


@app.command()
def told(dataset: Path, plain: Path, told: Path) -> None:
    """What the motion as an input is worth, and what further training. PLAIN was trained with ``told = 0``, TOLD with a
    share; each with a flat prior and with the motion. Beside them stand the shipped weights of PLAIN's array."""
    frames, radar = judged_frames(dataset)
    found, array = {}, read_run(plain).array.name
    for name, folder in (("shipped", pretrained_run(array)), ("plain", plain), ("told", told)):
        for share, suffix in ((0.0, ""), (1.0, ", told")):
            found[name + suffix] = scores(with_share(folder, share), frames, radar)
    print_scores(array, found, TOLD_PAIRS)


@app.command()
def unseen(
    dataset: Path,
    runs: Annotated[list[Path] | None, typer.Argument()] = None,
    array: Annotated[str, typer.Option()] = "sparse6",
) -> None:
    """Runs and untrained methods on drives through cities that no weights have seen, ``build/study/unseen`` of ``make
    study``: of all and of each city; then each less the best untrained method that is told the motion. All channels
    stand beside the array; they have more truth cells above their noise, so that no difference to them is paired."""
    frames, radar = judged_frames(dataset)
    answers: dict[str, Answer] = {
        f"{of}, {view}": answer for of in (array, FULL) for view, answer in untrained(VIEWS, of, radar).items()
    }
    for folder in (pretrained_run(array), *(runs or ())):
        answers[folder.name] = with_share(folder, None)
    found = {name: scores(answer, frames, radar) for name, answer in answers.items()}
    reference = f"{array}, likes-view-ego"
    pairs = [(name, reference) for name in found if name != reference and not name.startswith(FULL)]
    scenes = np.array([frame.scene for frame in frames])
    for scene in (None, *dict.fromkeys(scenes.tolist())):
        chosen = np.flatnonzero((scenes == scene) | (scene is None))
        print_scores(scene or "both", {name: one.of_frames(chosen) for name, one in found.items()}, pairs)


def judged_frames(dataset: Path) -> tuple[list[Frame], Radar]:
    """Frames of the test split, and their radar."""
    opened = open_dataset(dataset)
    frames = list(opened.frames("test", ("range_channel", "velocity", "image")))
    return frames, radar_of(opened.description(), dataset / MANIFEST)


def untrained(names: Iterable[str], array: str, radar: Radar) -> dict[str, Answer]:
    """Methods without weights, by their names."""
    return {name: array_answer(name, choose_array(array, radar), radar) for name in names}


def with_share(folder: Path, share: float | None) -> NetworkAnswer:
    """The run's network, told the motion if the share is above 0, whatever it was trained with; None for its own."""
    run, imager = load_imager(folder)
    if share is not None:
        imager.config = imager.config.model_copy(update={"told": share})
    return network_answer(run, imager)


def _estimated(frame: Frame, answer: Answer) -> Frame:
    """The frame with the velocity that it shows; said beside the truth, in the radar frame."""
    seen = Measurement("", frame.frame_id, Cells(frame.range_channel, frame.velocity), frame.noise_power, None)
    truth, found = EgoMotion.of_pose(frame.sensor_velocity, frame.sensor_orientation), answer.seen_motion(seen)
    print(f"frame {frame.frame_id}: {truth.forward_mps:.3f}, {truth.left_mps:.3f} m/s; estimated {found}")
    if found is None:
        raise SystemExit(f"frame {frame.frame_id} shows no velocity")
    return replace(
        frame, sensor_velocity=(found.forward_mps, found.left_mps, 0.0), sensor_orientation=(1.0, 0.0, 0.0, 0.0)
    )


def scores(answer: Answer, frames: Sequence[Frame], radar: Radar) -> Scores:
    cells, errors = [], []
    for frame in frames:
        rows, noise = frame.range_channel[0], frame.noise_power
        truth = np.asarray(frame.image, dtype=np.float64) * frame.image_peak
        image, found = answer.scored(truth, rows, noise, known_world(vars(frame), radar)[0])
        cells.append(found)
        errors.append(nmse(image, truth))
    return Scores(cells, np.array(errors))


def print_scores(where: str, found: Mapping[str, Scores], pairs: Iterable[tuple[str, str]]) -> None:
    """A row for each answer, then one for what the first of each pair scores less the second."""
    for name, one in found.items():
        print_row(where, name, one.intervals())
    for name, other in pairs:
        print_row(where, f"{name} less {other}", found[name].less(found[other]))


def print_row(where: str, name: str, intervals: tuple[Interval, Interval]) -> None:
    shown = (f"{one.value:.3f} ({one.low:.3f} to {one.high:.3f})" for one in intervals)
    print(f"| {where} | {name} | {' | '.join(shown)} |", flush=True)


if __name__ == "__main__":
    app()
