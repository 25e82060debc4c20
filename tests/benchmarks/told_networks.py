"""What the sensor's motion as an input is worth, and what further training: docs/notes/ego-motion.md and weights.md.

    python tests/benchmarks/told_networks.py DATASET PLAIN TOLD

Runs on the frames of the test split at their strongest Doppler peaks: PLAIN was trained with ``told = 0``, TOLD with a
share; each with a flat prior and with the motion. Beside them stand the shipped weights of PLAIN's array. Lines as
those of ``ego_motion.py`` beside it.
"""

import sys
from pathlib import Path

from ego_motion import difference, judged_frames, row, scored

from trainer.metrics.bootstrap import bootstrap_mean
from trainer.metrics.cells import average_precision
from trainer.run.answers import NetworkAnswer, network_answer
from trainer.run.folder import load_imager, read_run
from trainer.run.pretrained import pretrained_run

PAIRS = (
    ("plain", "shipped"), ("told", "plain"), ("plain, told", "plain"), ("told, told", "plain"),
    ("told, told", "plain, told"), ("told, told", "told"), ("told, told", "shipped, told"),
)  # fmt: skip


def main(dataset: Path, plain: Path, told: Path) -> None:
    frames, radar = judged_frames(dataset)
    found, array = {}, read_run(plain).array.name
    for name, folder in (("shipped", pretrained_run(array)), ("plain", plain), ("told", told)):
        for share, suffix in ((0.0, ""), (1.0, ", told")):
            found[name + suffix] = scored(with_share(folder, share), frames, radar)
    for name, (ranking, errors) in found.items():
        row(array, name, average_precision(ranking), bootstrap_mean(errors))
    for one, other in PAIRS:
        difference(array, f"{one} less {other}", found[one], found[other])


def with_share(folder: Path, share: float) -> NetworkAnswer:
    """The run's network, told the motion if the share is above 0, whatever it was trained with."""
    run, imager = load_imager(folder)
    imager.config = imager.config.model_copy(update={"told": share})
    return network_answer(run, imager)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
