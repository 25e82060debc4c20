"""After a run with an error budget: what was achieved, measured on its own frames and written beside the prediction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from datafactory.accuracy.budget import Budget, SweptScene, power_errors, worst_of
from datafactory.accuracy.chain import as_set, at_rest_or_not, cube_as_set, images_as_set
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.knobs import REFERENCE_TERMS, REFERENCE_TOLERANCE, Settings
from datafactory.accuracy.prices import Errors
from datafactory.accuracy.probes import Probe, traced
from datafactory.accuracy.variants import reference_moments
from datafactory.paths.table import PathTable
from datafactory.run.cache import Announce
from datafactory.run.shards import split_of, write_manifest
from datafactory.synthesis.cube import cube_of_paths
from shared.dataset import Frame
from shared.dataset.folder import open_dataset, read_manifest
from shared.dataset.reading import read_frame
from shared.radar import Radar

HONEST_DB = 3.0
"""Achieved and predicted error may differ by this much."""
CHECK_DRAW = 1
"""Of the rays for the power in cells: not those of the prediction, nor of its reference."""
OF_PATHS = ("rays", "depth")
CHOSEN = (*OF_PATHS, "prune_db", "tolerance", "truth_terms")


def check(budget: Budget, directory: Path, announce: Announce) -> None:
    """Measure the errors of the finished run on the frames swept and on one that was not; print and record them.

    The image is the dataset's own, read back, in the Doppler cells that its noise chose; of traced paths there is none.
    For the power in a cell the rays are drawn anew: the realisations are not those of the prediction.
    """
    started = time.perf_counter()
    choice = budget.choice
    with threadpool_limits(limits=1):
        achieved = worst_of([_achieved(scene, scene.swept, budget, directory) for scene in budget.scenes])
        others = [_achieved(scene, scene.elsewhere, budget, directory) for scene in budget.scenes if scene.elsewhere]
    predicted = choice.predicted.measured()
    differences = {name: round(value - predicted[name], 1) for name, value in achieved.measured().items()}
    honest = max(map(abs, differences.values())) <= HONEST_DB
    chosen = OF_PATHS if budget.menu.paths_only else CHOSEN
    entry: dict[str, Any] = {
        "budget_db": budget.level_db,
        "keeps_budget": choice.keeps_budget,
        "settings": {name: getattr(choice.settings, name) for name in chosen},
        "work_per_frame": choice.work,
        "frames": [probe.frame_id for scene in budget.scenes for probe in scene.swept],
        "predicted": predicted,
        "achieved": achieved.measured(),
        "achieved_less_predicted_db": differences,
        "prediction_within_3_db": honest,
        "other_frames": [probe.frame_id for scene in budget.scenes for probe in scene.elsewhere],
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


def _achieved(scene: SweptScene, probes: Sequence[Probe], budget: Budget, directory: Path) -> Errors:
    radar, window = budget.order.radar, budget.order.processing.truth_window
    settings = replace(
        budget.choice.settings,
        effects=scene.effects,
        truth_window=window,
        video_phase=radar.waveform.residual_video_phase,
    )
    cube, image = list[float](), list[float]()
    for probe in () if budget.menu.paths_only else probes:
        paths = traced(probe, settings, radar)
        converged = at_rest_or_not(paths, settings, radar)
        exact = cube_of_paths(converged, radar, REFERENCE_TOLERANCE, model=settings.wave_model())
        cube.append(relative_l2(cube_as_set(as_set(paths, settings, radar), settings, radar), exact))
        stored = _frame(directory, probe.frame_id, budget.order.split)
        image.append(_stored_image_error(stored, converged, settings, radar))
    return Errors.of(cube, image, power_errors(probes, scene, settings, budget.menu, radar, {}, CHECK_DRAW))


def _stored_image_error(frame: Frame, paths: PathTable, settings: Settings, radar: Radar) -> float:
    """Of the image in the dataset against the converged one of the same paths in the same Doppler cells."""
    waveform = radar.waveform
    cells = np.rint(frame.velocity[0] / waveform.velocity_step_mps).astype(np.int64) + waveform.chirps // 2
    moments = reference_moments(paths, radar, cells, REFERENCE_TERMS, model=settings.wave_model())
    expected = images_as_set([moments], settings, radar, size=1)[0]
    return peak_error(frame.image * np.float32(frame.image_peak), expected)


def _frame(directory: Path, frame_id: int, pattern: str) -> Frame:
    split = split_of(frame_id, pattern)
    place = sum(split_of(index, pattern) == split for index in range(frame_id))
    path, row = open_dataset(directory).rows(split)[place]
    return read_frame(path, row, ("velocity", "image"))
