"""After a run with an error budget: what was achieved, measured on its own frames and written beside the prediction."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from datafactory.accuracy.budget import Budget, errors_together
from datafactory.accuracy.cache import Announce
from datafactory.accuracy.errors import Errors, worst_of
from datafactory.accuracy.knobs import POWER_KNOBS, SIGNAL_KNOBS
from datafactory.accuracy.looking import Cells
from datafactory.accuracy.power import Kept
from datafactory.accuracy.samples import Sample
from datafactory.run.shards import write_manifest
from shared.dataset.folder import open_dataset, read_manifest
from shared.dataset.locations import Location
from shared.dataset.reading import read_frame

HONEST_DB = 3.0
"""Achieved and predicted error may differ by this much."""
CHECK_DRAW = 1
"""Of the rays for the power in cells: not those of the prediction, nor of its reference."""


def check(budget: Budget, directory: Location, announce: Announce) -> None:
    """Measure the errors of the finished run on the frames swept and on one that was not; print and record them.

    The image is the dataset's own, read back, in the Doppler cells that its noise chose; of traced paths there is none.
    For the power in a cell the rays are drawn anew: the realisations are not those of the prediction.
    """
    started = time.perf_counter()
    choice, menu = budget.choice, budget.menu
    dataset = None if menu.paths_only else open_dataset(directory)

    def stored(sample: Sample) -> tuple[Cells, NDArray]:
        """The frame's row."""
        assert dataset is not None
        split, place = budget.deal.place_of(sample.frame_id)
        frame = read_frame(*dataset.rows(split)[place], ("velocity", "image"))
        cells = sample.radar.waveform.doppler_cells(frame.velocity[0])
        return cells, frame.image * np.float32(frame.image_peak)

    def achieved_by(samples: tuple[Sample, ...]) -> Errors:
        return errors_together(samples, choice.settings, menu, Kept(), CHECK_DRAW, stored)

    with threadpool_limits(limits=1):
        achieved = worst_of([achieved_by(scene.swept) for scene in budget.scenes])
        others = [achieved_by(scene.elsewhere) for scene in budget.scenes if scene.elsewhere]
    predicted = choice.predicted.measured()
    differences = {name: round(value - predicted[name], 1) for name, value in achieved.measured().items()}
    honest = max(map(abs, differences.values())) <= HONEST_DB
    chosen = POWER_KNOBS if menu.paths_only else (*POWER_KNOBS, *SIGNAL_KNOBS)
    entry: dict[str, Any] = {
        "budget_db": budget.level_db,
        "keeps_budget": choice.keeps_budget,
        "settings": {name: getattr(choice.settings, name) for name in chosen},
        "work_per_frame": choice.work,
        "frames": [sample.frame_id for scene in budget.scenes for sample in scene.swept],
        "predicted": predicted,
        "achieved": achieved.measured(),
        "achieved_less_predicted_db": differences,
        "prediction_within_3_db": honest,
        "other_frames": [sample.frame_id for scene in budget.scenes for sample in scene.elsewhere],
        "achieved_on_other_frames": worst_of(others).measured() if others else None,
    }
    manifest = read_manifest(directory)
    manifest["error_budget"] = entry
    manifest["made"]["error_budget_check_seconds"] = round(time.perf_counter() - started, 1)
    write_manifest(directory, manifest)
    announce(f"error predicted: {choice.predicted}; achieved: {achieved}")
    if others:
        announce(f"error on frames that were not swept: {worst_of(others)}")
    if not honest:
        announce(f"warning: prediction and achieved error differ by more than {HONEST_DB:.0f} dB")
    if achieved.worst_db > budget.level_db:
        announce(f"warning: the error budget of {budget.level_db:g} dB is not kept")
