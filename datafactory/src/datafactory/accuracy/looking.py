"""Frames of the chain under the settings of knobs, looked at through its hook: timed, kept, varied.

The chain is :mod:`datafactory.frame.chain`, the one that a run has; what the pipeline cannot be asked for
(:mod:`datafactory.accuracy.variants`) takes the place of a step's function here.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy import knobs, variants
from datafactory.accuracy.clock import Clock
from datafactory.accuracy.knobs import KnobSettings
from datafactory.accuracy.work import Work, cube_work, truth_work
from datafactory.frame.chain import TracedSource, measured
from datafactory.frame.defaults import IMAGE_BATCH
from datafactory.frame.measurement import detected_cells, image
from datafactory.paths.storage import TracedFrame
from datafactory.run.shards import write_shard
from shared.dataset import Frame, arrow_schema, description
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum
from shared.signal.windows import cell_noise_power


class Look:
    """A hook of the chain: one frame under some settings.

    :param clock: times the stages
    :param index: of the frame among those that are measured together
    :param rows: [R] Doppler cell of each truth row, where it is not to be the frame's own
    :param exact: the truth from the virtual sensor's whole cube
    """

    def __init__(
        self,
        settings: KnobSettings,
        clock: Clock,
        index: int = 0,
        rows: NDArray[np.int64] | None = None,
        exact: bool = False,
    ) -> None:
        self.settings, self.clock, self.index, self.rows, self.exact = settings, clock, index, rows, exact
        self.reached = self.paths = 0
        self.cube_work = self.truth_work = Work()
        self.cube: NDArray = np.zeros(0)
        self.cells: NDArray[np.int64] = np.zeros(0, dtype=np.int64)

    def __call__(self, step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """The step's value under these settings; see :class:`datafactory.frame.measurement.Hook`."""
        looks: dict[str, Callable[..., Any]] = {
            "illuminate": self._illuminate,
            "prune": self._prune,
            "motion": self._motion,
            "sorting": self._sorting,
            "cube": self._cube,
            "range-Doppler": self._spectra,
            "Doppler choice": self._choice,
            "truth": self._truth,
        }
        return looks[step](function, *arguments) if step in looks else function(*arguments)

    def _illuminate(self, function: Callable[..., Any], *arguments: Any) -> Any:
        paths = function(*arguments)
        self.reached = len(paths)
        return paths

    def _prune(self, function: Callable[..., Any], *arguments: Any) -> Any:
        paths = function(*arguments)
        self.paths = len(paths)
        return paths

    def _motion(self, function: Callable[..., Any], paths: Any, radar: Radar, *arguments: Any) -> Any:
        paths = function(paths, radar, *arguments)
        if self.settings.delays == "linear":
            paths = variants.linear_delays(paths, radar)
        return variants.float32_geometry(paths) if self.settings.width == "float32 geometry" else paths

    def _with_video_phase(self, radar: Radar) -> Radar:
        """The radar with the residual video phase of these settings: it decides which kernel a path may have."""
        phase = self.settings.video_phase
        if phase == radar.waveform.residual_video_phase:
            return radar
        waveform = radar.waveform.model_copy(update={"residual_video_phase": phase})
        return radar.model_copy(update={"waveform": waveform})

    def _sorting(self, function: Callable[..., Any], paths: Any, radar: Radar, *arguments: Any) -> Any:
        radar = self._with_video_phase(radar)
        work = partial(function, paths, radar, *arguments)
        found = self.clock("delays and spread", work, key=(self.index, self.settings.of_signal()), part="sorting")
        self.cube_work = cube_work(found, radar, *arguments)
        return found

    def _cube(self, function: Callable[..., Any], paths: Any, radar: Radar, *arguments: Any) -> Any:
        work = partial(function, paths, self._with_video_phase(radar), *arguments)
        self.cube = self.clock("delays and spread", work, key=(self.index, self.settings.of_signal()))
        return self.cube

    def _spectra(self, function: Callable[..., Any], *arguments: Any) -> Any:
        work = partial(function, *arguments)
        return self.clock("range-Doppler", work, key=(self.index, self.settings.of_signal()))

    def _choice(self, function: Callable[..., Any], *arguments: Any) -> Any:
        selection = function(*arguments)
        self.cells = selection.cells[0]
        return selection

    def _truth(self, function: Callable[..., Any], paths: Any, radar: Radar, cells: Any, *arguments: Any) -> Any:
        rows = cells if self.rows is None else self.rows
        if self.exact:
            function = variants.reference_moments
        else:
            self.truth_work = truth_work(paths, radar, rows, *arguments)
        work = partial(function, paths, radar, rows, *arguments)
        return self.clock("truth", work, key=(self.index, self.exact, *self.settings.of_truth()))


@dataclass(frozen=True, eq=False)
class Outcome:
    """Frames made under some settings.

    :param reached: paths within reach, by frame; :param paths: those kept after pruning
    :param cubes: [chirps, samples, channels] of each frame
    :param cells: [R] first Doppler cell of each row and frame
    :param images: [B, R, U] magnitudes [sqrt(W)]
    :param frames: what a run would write
    :param cube_work, truth_work: counted, of each frame; of an exact truth nothing
    """

    reached: tuple[int, ...]
    paths: tuple[int, ...]
    cubes: tuple[NDArray, ...]
    cells: tuple[NDArray[np.int64], ...]
    images: NDArray[np.float32]
    frames: tuple[Frame, ...]
    cube_work: tuple[Work, ...]
    truth_work: tuple[Work, ...]

    def detections(self, radar: Radar) -> list[NDArray[np.bool_]]:
        """[R, U] maps of each frame's detected cells."""
        return [detected_cells(image, cell_noise_power(radar)) for image in self.images]


def run(
    frames: Sequence[TracedFrame],
    settings: KnobSettings,
    radar: Radar,
    clock: Clock,
    rows: Sequence[NDArray[np.int64]] | None = None,
    batch: int = IMAGE_BATCH,
    exact: bool = False,
) -> Outcome:
    """All stages after tracing, of at most ``batch`` frames.

    :param rows: [R] Doppler cells of each frame's truth, so that image errors are the image's own; each frame's own
        without
    :param batch: frames whose images share their time
    :param exact: see :class:`Look`
    """
    looks = [Look(settings, clock, index, rows[index] if rows else None, exact) for index in range(len(frames))]
    chain = settings.chain()
    measurements = [
        measured(TracedSource(frame, chain), radar, look) for frame, look in zip(frames, looks, strict=True)
    ]
    images: list[NDArray[np.float32]] = []

    def at(step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        moments, *others = arguments
        padded = np.zeros((max(batch, len(moments)), *moments.shape[1:]), dtype=np.complex64)
        padded[: len(moments)] = moments
        if settings.truth_wave == "plane":
            flat = radar.model_copy(update={"array": radar.virtual_sensor})
            work = partial(delay_and_sum, padded[:, 0], flat)
        else:
            work = partial(function, padded, *others)
        made = clock("image", work, share=batch, key=(exact, *settings.of_image()))[: len(moments)]
        images.append(np.abs(made))
        return made

    made = tuple(frame for frame, _ in image(measurements, radar, chain.processing.store, at))
    return Outcome(
        reached=tuple(look.reached for look in looks),
        paths=tuple(look.paths for look in looks),
        cubes=tuple(look.cube for look in looks),
        cells=tuple(look.cells for look in looks),
        images=images[0],
        frames=made,
        cube_work=tuple(look.cube_work for look in looks),
        truth_work=tuple(look.truth_work for look in looks),
    )


def reference_of(
    frames: Sequence[TracedFrame],
    settings: KnobSettings,
    radar: Radar,
    rows: Sequence[NDArray[np.int64]] | None = None,
) -> Outcome:
    """The converged frames: what every setting on the same paths is held against.

    :param settings: of which tolerance, pruning and truth give way
    :param rows: see :func:`run`
    """
    converged = replace(
        settings,
        prune_db=knobs.UNPRUNED_DB,
        tolerance=knobs.REFERENCE_TOLERANCE,
        truth_terms=knobs.REFERENCE_TERMS,
    )
    return run(frames, converged, radar, Clock(), rows, batch=1, exact=True)


def write_seconds(frame: Frame, radar: Radar, repeats: int) -> float:
    """Median seconds to write one frame as a shard, flushed to the disk."""
    schema = arrow_schema(description(radar, len(frame.velocity), "range-channel"))
    clock = Clock(repeats)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "train", "part-00000.parquet")
        clock("write", partial(write_shard, path, [frame], schema))
    return clock.seconds()["write"]
