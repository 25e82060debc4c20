"""After a run with an error budget: what was achieved, measured on its own frames and written beside the prediction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from datafactory.accuracy.budget import Budget, as_run, power_errors, worst_of
from datafactory.accuracy.cache import Announce
from datafactory.accuracy.clock import Clock
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.looking import reference_of, run
from datafactory.accuracy.prices import Errors
from datafactory.accuracy.samples import SampleFrame, traced
from datafactory.run.shards import write_manifest
from shared.dataset import Frame
from shared.dataset.folder import Split, open_dataset, read_manifest
from shared.dataset.locations import Location
from shared.dataset.reading import read_frame

HONEST_DB = 3.0
"""Achieved and predicted error may differ by this much."""
CHECK_DRAW = 1
"""Of the rays for the power in cells: not those of the prediction, nor of its reference."""
OF_PATHS = ("rays", "depth")
CHOSEN = (*OF_PATHS, "prune_db", "tolerance", "truth_terms")


def check(budget: Budget, directory: Location, announce: Announce) -> None:
    """Measure the errors of the finished run on the frames swept and on one that was not; print and record them.

    The image is the dataset's own, read back, in the Doppler cells that its noise chose; of traced paths there is none.
    For the power in a cell the rays are drawn anew: the realisations are not those of the prediction.
    """
    started = time.perf_counter()
    choice = budget.choice
    with threadpool_limits(limits=1):
        achieved = worst_of([_achieved(scene.swept, budget, directory) for scene in budget.scenes])
        others = [_achieved(scene.elsewhere, budget, directory) for scene in budget.scenes if scene.elsewhere]
    predicted = choice.predicted.measured()
    differences = {name: round(value - predicted[name], 1) for name, value in achieved.measured().items()}
    honest = max(map(abs, differences.values())) <= HONEST_DB
    chosen = OF_PATHS if budget.menu.paths_only else CHOSEN
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


def _achieved(samples: Sequence[SampleFrame], budget: Budget, directory: Location) -> Errors:
    radar, chosen = budget.order.radar, budget.choice.settings
    cube, image, settings = list[float](), list[float](), as_run(chosen, budget.order)
    for sample in () if budget.menu.paths_only else samples:
        stored = _stored_frame(directory, *budget.deal.place_of(sample.frame_id))
        rows = radar.waveform.doppler_cells(stored.velocity[0])
        frames = [traced(sample, settings, radar)]
        reference = reference_of(frames, settings, radar, [rows])
        cube.append(relative_l2(run(frames, settings, radar, Clock(), [rows], batch=1).cubes[0], reference.cubes[0]))
        image.append(peak_error(stored.image * np.float32(stored.image_peak), reference.images[0]))
    return Errors.of(cube, image, power_errors(samples, chosen, budget.menu, budget.order, {}, CHECK_DRAW))


def _stored_frame(directory: Location, split: Split, place: int) -> Frame:
    """Velocity and image of the frame at a place of its split."""
    path, row = open_dataset(directory).rows(split)[place]
    return read_frame(path, row, ("velocity", "image"))
