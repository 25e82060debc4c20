"""What the sensor's own motion is worth: the table of docs/notes/ego-motion.md.

    python tests/benchmarks/ego_motion.py DATASET [sparse6,sparse4,full]

Frames of the test split at their strongest Doppler peaks; average precision and NMSE with bootstrap intervals over the
frames, paired for differences. ``estimated`` is told the velocity that the frame itself shows; before the table stands
how far that is from the truth.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.dataset import Frame
from shared.dataset.folder import MANIFEST, open_dataset
from shared.dataset.reading import radar_of
from shared.radar import Radar
from shared.signal.ego_motion import EgoMotion
from trainer.data.arrays import choose_array
from trainer.data.measurements import Cells, Measurement, known_world
from trainer.metrics.bootstrap import Interval, bootstrap_mean
from trainer.metrics.cells import CellScores, Ranking, average_precision, pooled
from trainer.metrics.image import nmse
from trainer.run.answers import Answer, array_answer, network_answer
from trainer.run.folder import load_imager
from trainer.run.pretrained import pretrained_run

Scored = tuple[Ranking, NDArray[np.float64]]
"""The detections of all frames, and the NMSE of each."""
VIEWS = ("iaa-view", "likes-view", "likes-view-ego")
PAIRS = (
    ("likes-view", "iaa-view"), ("likes-view-ego", "likes-view"), ("network", "likes-view-ego"),
    ("network, told", "network"), ("estimated", "likes-view"),
)  # fmt: skip


def main(dataset: Path, arrays: Sequence[str]) -> None:
    frames, radar = judged_frames(dataset)
    for array in arrays:
        found = {name: scored(answer, frames, radar) for name, answer in _answers(array, radar)}
        views = array_answer("likes-view-ego", choose_array(array, radar), radar)
        found["estimated"] = scored(views, [_estimated(frame, views) for frame in frames], radar)
        for name, (ranking, errors) in found.items():
            row(array, name, average_precision(ranking), bootstrap_mean(errors))
        for one, other in PAIRS:
            if one in found:
                difference(array, f"{one} less {other}", found[one], found[other])


def judged_frames(dataset: Path) -> tuple[list[Frame], Radar]:
    """Frames of the test split, and their radar."""
    opened = open_dataset(dataset)
    frames = list(opened.frames("test", ("range_channel", "velocity", "image")))
    return frames, radar_of(opened.description(), dataset / MANIFEST)


def _answers(array: str, radar: Radar) -> Iterator[tuple[str, Answer]]:
    chosen = choose_array(array, radar)
    for name in VIEWS:
        yield name, array_answer(name, chosen, radar)
    if array != "full":
        run, imager = load_imager(pretrained_run(array))
        yield "network", network_answer(run, imager)
        _, told = load_imager(pretrained_run(array))
        told.config = told.config.model_copy(update={"told": 1.0})
        yield "network, told", network_answer(run, told)


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


def scored(answer: Answer, frames: Sequence[Frame], radar: Radar) -> Scored:
    cells, errors = scores(answer, frames, radar)
    return pooled(cells), errors


def scores(answer: Answer, frames: Sequence[Frame], radar: Radar) -> tuple[list[CellScores], NDArray[np.float64]]:
    """([frames] detections, [frames] NMSE)."""
    cells, errors = [], []
    for frame in frames:
        rows, noise = frame.range_channel[0], frame.noise_power
        truth = np.asarray(frame.image, dtype=np.float64) * frame.image_peak
        image, found = answer.scored(truth, rows, noise, known_world(vars(frame), radar)[0])
        cells.append(found)
        errors.append(nmse(image, truth))
    return cells, np.array(errors)


def difference(array: str, name: str, one: Scored, other: Scored) -> None:
    """What one scores less another, frame by frame."""
    row(array, name, average_precision(one[0], other[0]), bootstrap_mean(one[1] - other[1]))


def row(array: str, name: str, precision: Interval, error: Interval) -> None:
    shown = (f"{one.value:.3f} ({one.low:.3f} to {one.high:.3f})" for one in (precision, error))
    print(f"| {array} | {name} | {' | '.join(shown)} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2].split(",") if len(sys.argv) > 2 else ("sparse6", "sparse4", "full"))
