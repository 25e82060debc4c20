"""Scores of single frames of the test split: the cells that detection, generalisation and cost against quality
share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shared.dataset import Frame
from shared.dataset.folder import Dataset
from shared.dataset.reading import read_frame
from shared.radar import Radar
from trainer.data.arrays import ArrayChoice
from trainer.data.measurements import known_world
from trainer.evaluation.experiments.bench import Bench, Experiment, FrameRef, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.page import scene_levels
from trainer.evaluation.report.tables import Condition
from trainer.evaluation.store import Values
from trainer.metrics.cells import CellScores, Ranking, pooled, score_cells
from trainer.metrics.detection import (
    D_MAX_BINS,
    PROMINENCES,
    TRUTH_PROMINENCE,
    find_image_peaks,
    paper_sweep,
    strict_counts,
)
from trainer.metrics.image import SPAN_DB, SSIM_WINDOW, nmse, nmse_best_scaled, ssim
from trainer.metrics.residual import explain
from trainer.run.imager import AMPLITUDE

CELLS = "frames"
STRICT_PROMINENCE = 0.05
RESIDUAL = ("rows", "explained_rows", "lines", "unsupported", "energy", "left")
"""Of :class:`trainer.metrics.residual.Explanation`."""
COLUMNS = ("range_channel", "velocity", "image", "targets")


def frame_refs(dataset: Dataset, split: str, most: int) -> tuple[tuple[FrameRef, ...], dict[str, int]]:
    """(up to ``most`` frames of each kind, those left out by kind); in the dataset's order.

    :raises InputError: a split without frames
    """
    refs = [
        FrameRef(path, row, frame.frame_id, frame.kind, frame.scene)
        for (path, row), frame in zip(dataset.rows(split), dataset.frames(split, ()), strict=True)
    ]
    kinds = grouped(refs, "kind")
    left_out = {kind: len(of_kind) - most for kind, of_kind in kinds.items() if len(of_kind) > most}
    return tuple(ref for of_kind in kinds.values() for ref in of_kind[:most]), left_out


def grouped(refs: Sequence[FrameRef], by: Literal["kind", "scene"]) -> dict[str, list[FrameRef]]:
    """The frames by their kind or scene, in order of appearance."""
    names = dict.fromkeys(getattr(ref, by) for ref in refs)
    return {name: [ref for ref in refs if getattr(ref, by) == name] for name in names}


def one_of_each_scene(refs: Sequence[FrameRef], count: int) -> tuple[FrameRef, ...]:
    """``count`` frames, the first of each scene before the second of any."""
    turns = [(turn, ref) for of_scene in grouped(refs, "scene").values() for turn, ref in enumerate(of_scene)]
    return tuple(ref for _, ref in sorted(turns, key=lambda entry: entry[0])[:count])


class FrameByFrame(Experiment):
    """An experiment whose scenes are frames of the test split."""

    def frames(self, bench: Bench) -> Sequence[FrameRef]:
        """The frames that have cells."""
        return bench.frames

    def conditions(self, bench: Bench) -> Sequence[Condition]:
        return [ref.named for ref in self.frames(bench)]

    def scene(self, bench: Bench, place: int) -> Frame:
        return load_frame(self.frames(bench)[place])

    def inputs(self, bench: Bench) -> object:
        return bench.data_sha256


class OfFrames(FrameByFrame):
    """An experiment on the scores of single frames, whose cells it shares with the others."""

    cells = CELLS

    def refs(self, bench: Bench) -> tuple[FrameRef, ...]:
        """The frames that it looks at, those of scenes and not those of point targets."""
        return tuple(ref for ref in bench.frames if ref.kind == "scene")

    def scores(self, bench: Bench, results: Results) -> FrameScores:
        """Of the frames that it looks at."""
        return FrameScores(results, self.refs(bench))

    def score(self, bench: Bench, contender: Contender, place: int, scene: Frame) -> Values:
        return score_frame(contender, scene)

    def truths(self, bench: Bench, place: int) -> Mapping[str, Callable[[Frame], Values]]:
        return {array.name: partial(score_truth, bench.radar, array) for array in bench.arrays}

    def obstacle(self, bench: Bench) -> str | None:
        if not self.refs(bench):
            return "the test split has no scene frames"
        shape = bench.radar.waveform.range_bins, bench.radar.grid.bins
        if min(shape) >= SSIM_WINDOW:
            return None
        return f"images have {shape[0]} x {shape[1]} bins, SSIM's window {SSIM_WINDOW} x {SSIM_WINDOW}"


def load_frame(ref: FrameRef) -> Frame:
    """The frame, read anew: :meth:`Experiment.tasks` keep it while its contenders take turns."""
    return read_frame(ref.path, ref.row, COLUMNS)


def true_magnitude(frame: Frame) -> NDArray[np.float64]:
    """[R, U] truth of a frame [sqrt(W)]."""
    return np.asarray(frame.image, dtype=np.float64) * frame.image_peak


def score_frame(contender: Contender, frame: Frame) -> Values:
    """All scores of one image against the frame's truth, at the strongest Doppler peaks, told the sensor's motion.

    paper [2 d_max, prominences, 4]: TP, FP, FN, TN by the paper's rules; strict [2 d_max, 3]: TP, FP, FN one to one;
    residual [6]: see :data:`RESIDUAL`; nmse (NaN unless in sqrt(W)), scaled_nmse, ssim []: NaN where the truth is
    empty; cells_matched [m], cells_false [f], cells_true []: see :class:`trainer.metrics.cells.CellScores`.
    """
    answer = contender.answer
    range_channel, noise = frame.range_channel[0], frame.noise_power
    truth = true_magnitude(frame)
    image, cells = answer.scored(truth, range_channel, noise, known_world(vars(frame), answer.radar)[0])
    detected, true = find_image_peaks(image), find_image_peaks(truth).above(TRUTH_PROMINENCE)
    paper = [[astuple(counts) for counts in paper_sweep(detected, true, PROMINENCES, d_max)] for d_max in D_MAX_BINS]
    prominent = detected.above(STRICT_PROMINENCE)
    strict = [astuple(strict_counts(prominent, true, d_max))[:3] for d_max in D_MAX_BINS]
    rows, chirps = range_channel[:, answer.channels], answer.radar.waveform.chirps
    explanation = explain(image, answer.radar.grid.u, rows, answer.line, noise, chirps)
    residual = [getattr(explanation, name) for name in RESIDUAL]
    values = {"paper": paper, "strict": strict, "residual": residual}
    quality = {"nmse": math.nan, "scaled_nmse": math.nan, "ssim": math.nan}
    if truth.any():
        levels = scene_levels(image, answer.unit, truth, SPAN_DB) / SPAN_DB + 1.0
        true_levels = scene_levels(truth, AMPLITUDE, truth, SPAN_DB) / SPAN_DB + 1.0
        quality["scaled_nmse"] = nmse_best_scaled(image, truth)
        quality["ssim"] = ssim(levels, true_levels)
        if answer.unit == AMPLITUDE:
            quality["nmse"] = nmse(image, truth)
    return {name: np.asarray(value, dtype=np.float64) for name, value in (values | quality | _stored(cells)).items()}


def score_truth(radar: Radar, array: ArrayChoice, frame: Frame) -> Values:
    """What the truth's own image scores against the truth cells that an array could find: the most that is possible."""
    truth = true_magnitude(frame)
    channels = len(array.line(radar))
    cells = score_cells(truth, truth, frame.noise_power, channels, radar.waveform.range_step_m)
    return {name: np.asarray(value, dtype=np.float64) for name, value in _stored(cells).items()}


def _stored(cells: CellScores) -> dict[str, NDArray[np.float64] | float]:
    return {"cells_matched": cells.matched, "cells_false": cells.false_alarms, "cells_true": float(cells.truths)}


@dataclass(frozen=True, eq=False)
class FrameScores:
    """The scores of some frames, by :func:`score_frame` and :func:`score_truth`."""

    results: Results
    refs: Sequence[FrameRef]

    def ranking(self, key: tuple[str, str]) -> Ranking:
        """Detections over the frames.

        :param key: (method, array); the method may be :data:`TRUTH`
        """
        found = [self.results[*key, ref.condition] for ref in self.refs]
        return pooled([CellScores(one["cells_matched"], one["cells_false"], int(one["cells_true"])) for one in found])

    def gathered(self, key: tuple[str, str], name: str) -> NDArray[np.float64]:
        """[frames, ...] one score of a (method, array)."""
        return np.stack([self.results[*key, ref.condition][name] for ref in self.refs])
