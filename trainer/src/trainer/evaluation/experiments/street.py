"""A street scene, imaged by everyone (the paper's Fig. 9), and the frames that the report shows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from shared.dataset import Frame
from shared.dataset.folder import Dataset
from shared.dataset.reading import open_shard, read_frame
from shared.physics.errors import figure_text
from shared.pictures import SPAN_DB, level_db, range_weighted
from shared.radar import Radar
from trainer.evaluation.experiments.bench import (
    Bench,
    Experiment,
    FrameRef,
    Numbers,
    Results,
    Task,
    task_of,
)
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.experiments.frames import load_frame, one_of_each_scene, static_world, true_magnitude
from trainer.evaluation.report.figures import image_sheet
from trainer.evaluation.report.page import (
    PEAKS,
    REPORT_SPAN_DB,
    WHOLE,
    ReportFrame,
    doppler_map,
    from_bytes,
    scene_levels,
    small_picture,
    to_bytes,
)
from trainer.evaluation.report.tables import TRUTH, MetricRow
from trainer.evaluation.store import Values
from trainer.run.targets import AMPLITUDE


class Street(Experiment):
    """What do the images look like?"""

    name = "street"
    cells = "images"
    title = "Street scene (paper, Fig. 9)"
    caption = (
        "One frame of the test split at the strongest Doppler peak of every range bin. Amplitudes weighted by range, "
        "those in sqrt(W) under the maximum of the truth (256 elements), relative ones and probabilities under their "
        "own."
    )

    def tasks(self, bench: Bench) -> Sequence[Task]:
        tasks = []
        for ref in shown_frames(bench):
            inputs = [bench.data_sha256, ref.frame_id]
            tasks += [
                task_of(bench, contender, ref.condition, inputs, partial(_levels, contender, ref))
                for contender in bench.contenders
            ]
            tasks.append(task_of(bench, None, ref.condition, inputs, partial(_truth, bench.radar, ref)))
        return tasks

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        """A street scene is to be looked at."""

    def figures(self, bench: Bench, results: Results, rows: Sequence[MetricRow]) -> dict[str, Figure]:
        ref = next((ref for ref in shown_frames(bench) if ref.kind == "scene"), shown_frames(bench)[0])
        truth = np.maximum(from_bytes(results[TRUTH, "", ref.condition]["levels"]), -SPAN_DB)
        drawn = {}
        for array in (one.name for one in bench.arrays):
            of_array = [contender for contender in bench.contenders if contender.array.name == array]
            found = {one.method: from_bytes(results[*one.key, ref.condition]["levels"]) for one in of_array}
            levels = {method: np.maximum(image, -SPAN_DB) for method, image in found.items()}
            title = f"{self.title}: {figure_text(ref.scene)}, frame {ref.frame_id}, {figure_text(array)}"
            drawn[f"{self.name}-{array}"] = image_sheet(levels, truth, bench.radar, title)
        return drawn


def shown_frames(bench: Bench) -> tuple[FrameRef, ...]:
    """The frames that report and figure show."""
    return one_of_each_scene(bench.frames, bench.config.shown)


def report_frames(bench: Bench, results: Results, dataset: Dataset) -> list[ReportFrame]:
    """The frames to look at.

    :param results: the cells of the street
    :param dataset: whose camera pictures stand beside them
    """
    frames = []
    for ref in shown_frames(bench):
        known = results[TRUTH, "", ref.condition]
        truth, doppler = known["levels"], (WHOLE if known["doppler_whole"] else PEAKS, known["doppler"])
        images = {one.name: results[*one.key, ref.condition]["levels"] for one in bench.contenders}
        # The cut starts where the truth is strongest.
        row = int(truth.max(axis=1).argmax())
        camera = small_picture(dataset, ref.frame_id)
        frames.append(ReportFrame(f"{ref.scene}, frame {ref.frame_id}", row, {**images, TRUTH: truth}, doppler, camera))
    return frames


def _levels(contender: Contender, ref: FrameRef) -> Values:
    frame = load_frame(ref)
    world = static_world(frame, contender.answer.radar)
    image, _ = contender.answer.image_and_score(frame.range_channel[0], frame.noise_power, world)
    return {"levels": to_bytes(scene_levels(image, contender.answer.unit, true_magnitude(frame)))}


def _truth(radar: Radar, ref: FrameRef) -> Values:
    """levels [R, U] of the truth; doppler [R, chirps] levels of the range-Doppler map, and whether it is the whole."""
    truth = true_magnitude(load_frame(ref))
    title, magnitude = doppler_map(_with_doppler(ref), radar)
    weighted = range_weighted(magnitude)
    return {
        "levels": to_bytes(scene_levels(truth, AMPLITUDE, truth)),
        "doppler": to_bytes(level_db(weighted, float(weighted.max()), REPORT_SPAN_DB)),
        "doppler_whole": np.asarray(title == WHOLE),
    }


def _with_doppler(ref: FrameRef) -> Frame:
    """The frame with what its shard has of Doppler."""
    with open_shard(ref.path) as file:
        stored = [name for name in ("range_doppler", "cube") if name in file.schema_arrow.names]
    return read_frame(ref.path, ref.row, ("range_channel", "velocity", *stored))
