"""A street scene, imaged by everyone (the paper's Fig. 9), and the frames that the report shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from shared.dataset import Frame
from shared.dataset.folder import Dataset
from shared.dataset.reading import open_shard, read_frame
from shared.physics.errors import figure_text
from shared.pictures import SPAN_DB, level_db, range_weighted
from shared.radar import Radar
from trainer.data.measurements import known_world
from trainer.evaluation.experiments.bench import Bench, FrameRef, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.experiments.frames import FrameByFrame, one_of_each_scene, true_magnitude
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
from trainer.evaluation.report.tables import TRUTH, Numbers
from trainer.evaluation.store import Values
from trainer.run.imager import AMPLITUDE


class Street(FrameByFrame):
    """What do the images look like?"""

    name = "street"
    cells = "images"
    title = "Street scene (paper, Fig. 9)"
    caption = (
        "One frame of the test split at the strongest Doppler peak of every range bin. Amplitudes weighted by range, "
        "those in sqrt(W) under the maximum of the truth (256 elements), relative ones and probabilities under their "
        "own."
    )

    def frames(self, bench: Bench) -> Sequence[FrameRef]:
        """Those that report and figure show."""
        return one_of_each_scene(bench.frames, bench.config.shown)

    def score(self, bench: Bench, contender: Contender, place: int, scene: Frame) -> Values:
        world = known_world(vars(scene), bench.radar)[0]
        image, _ = contender.answer.image_and_score(scene.range_channel[0], scene.noise_power, world)
        return {"levels": to_bytes(scene_levels(image, contender.answer.unit, true_magnitude(scene)))}

    def truths(self, bench: Bench, place: int) -> Mapping[str, Callable[[Frame], Values]]:
        return {"": partial(_truth, bench.radar, self.frames(bench)[place])}

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        shown = self.frames(bench)
        ref = next((ref for ref in shown if ref.kind == "scene"), shown[0])
        truth = np.maximum(from_bytes(results[TRUTH, "", ref.condition]["levels"]), -SPAN_DB)
        drawn = {}
        for array in (one.name for one in bench.arrays):
            of_array = [contender for contender in bench.contenders if contender.array.name == array]
            images = {one.method: from_bytes(results[*one.key, ref.condition]["levels"]) for one in of_array}
            levels = {method: np.maximum(image, -SPAN_DB) for method, image in images.items()}
            title = f"{self.title}: {figure_text(ref.scene)}, frame {ref.frame_id}, {figure_text(array)}"
            drawn[f"{self.name}-{array}"] = image_sheet(levels, truth, bench.radar, title)
        return drawn

    def report_frames(self, bench: Bench, results: Results, dataset: Dataset) -> list[ReportFrame]:
        """The frames to look at.

        :param dataset: whose camera pictures stand beside them
        """
        frames = []
        for ref in self.frames(bench):
            known = results[TRUTH, "", ref.condition]
            truth, doppler = known["levels"], (WHOLE if known["doppler_whole"] else PEAKS, known["doppler"])
            images = {one.name: results[*one.key, ref.condition]["levels"] for one in bench.contenders}
            # The cut starts where the truth is strongest.
            row, name = int(truth.max(axis=1).argmax()), f"{ref.scene}, frame {ref.frame_id}"
            camera = small_picture(dataset, ref.frame_id)
            frames.append(ReportFrame(name, row, {**images, TRUTH: truth}, doppler, camera))
        return frames


def _truth(radar: Radar, ref: FrameRef, frame: Frame) -> Values:
    """levels [R, U] of the truth; doppler [R, chirps] levels of the range-Doppler map, and whether it is the whole."""
    truth = true_magnitude(frame)
    with open_shard(ref.path) as file:
        stored = [name for name in ("range_doppler", "cube") if name in file.schema_arrow.names]
    title, magnitude = doppler_map(read_frame(ref.path, ref.row, ("range_channel", "velocity", *stored)), radar)
    weighted = range_weighted(magnitude)
    return {
        "levels": to_bytes(scene_levels(truth, AMPLITUDE, truth)),
        "doppler": to_bytes(level_db(weighted, float(weighted.max()), REPORT_SPAN_DB)),
        "doppler_whole": np.asarray(title == WHOLE),
    }
