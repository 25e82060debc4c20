"""A radar, data and a run for evaluations of seconds."""

from dataclasses import replace
from typing import Any

from tiny_radar import RADAR as SHORT_RADAR
from tiny_radar import frame, tiny, write_dataset
from tiny_run import run_of

from trainer.data.arrays import ArrayChoice
from trainer.evaluation.evaluate import evaluate

RADAR = SHORT_RADAR.model_copy(
    update={"waveform": SHORT_RADAR.waveform.model_copy(update={"samples": 64, "range_bins": 48})}
)
"""Sees to 7 m: the cylinders of the paper stand at 5.7 m."""
FULL = ArrayChoice(name="full", rx=tuple(range(6)))
THIN = ArrayChoice(name="thin", rx=(0, 1, 2, 5))
QUICK: dict[str, Any] = {"frames": 3, "shown": 2, "trials": 2}


def make_data(directory, radar=RADAR):
    """Two training frames and four test frames, of which three are of a scene."""
    frames = [replace(frame(index, radar), kind="scene", scene="hall") for index in range(6)]
    frames[5] = replace(frames[5], kind="points", scene="none")
    return write_dataset(directory, {"train": frames[:2], "test": frames[2:]}, radar)


def strong_frame(index):
    """A frame whose echoes are 20 dB stronger: those beyond 5 m stand above the noise."""
    made = frame(index, RADAR)
    return replace(made, range_channel=10.0 * made.range_channel, image_peak=10.0 * made.image_peak)


def strong_dataset(directory, training=2, tested=1):
    """Strong frames, two to validate; those to test are 200 and the next."""
    places = {"train": range(training), "validation": (100, 101), "test": range(200, 200 + tested)}
    splits = {split: [strong_frame(index) for index in of_split] for split, of_split in places.items()}
    return write_dataset(directory, splits, RADAR)


def make_run(directory, array=THIN, radar=RADAR, datasets=(), **changes):
    return run_of(directory, radar, tiny(**changes), array, datasets)


def run_all(inputs, out, **changes):
    data, run, thin, measured = inputs
    arguments = {
        "run": [run], "methods": ["das", "omp", "unet"], "arrays": [str(thin), "full"], "measured": measured,
        "targets": 2,
    }  # fmt: skip
    changes = arguments | changes
    if changes["measured"] is None:
        del changes["targets"]
    return evaluate(data, out=out, **(QUICK | changes))
