"""Traced frames under some settings of the knobs: the chain's own frames, seen and timed through its hook.

Seconds are those of a frame on one core by stage of the chain, the median over frames and repeats. Writing waits for
the disk, and tracing on a GPU for that: they are timed on the wall clock. The rest is timed in processor time, which
neighbours on the machine hardly change. The image stage works on a batch, as a run does, and its time is shared by a
full batch."""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.knobs import KnobSettings
from datafactory.frame.chain import ChainSettings, TracedSource, measured
from datafactory.frame.measurement import image
from datafactory.paths.backend import traces_on_the_processor
from datafactory.paths.storage import TracedFrame
from datafactory.paths.table import PathTable
from datafactory.run.shards import write_shard
from datafactory.synthesis.cube import cube_of_paths
from shared.dataset import Frame, arrow_schema, description
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.imaging import sweep_moments
from shared.signal.windows import unit_hann

STAGE_OF = {
    "trace": "trace", "sorting": "delays and spread", "cube": "delays and spread", "range-Doppler": "range-Doppler",
    "truth": "truth", "image": "image", "write": "write",
}  # fmt: skip
"""Of each step that is timed, the stage that it is a part of."""
STAGES = tuple(dict.fromkeys(STAGE_OF.values()))
Value = TypeVar("Value")
REFERENCE_BLOCK = 32
"""Elements of the virtual sensor whose full cube is held at a time: 64 MB for the default waveform."""
REFERENCE_TOLERANCE = 1e-6
"""Of these cubes: the truth's own moments are complex64."""
OF_SIGNAL = ("sorting", "cube", "range-Doppler")
Cells = NDArray[np.int64]


class Clock:
    """Seconds by stage; a step whose settings an earlier run shares is not run again.

    :param repeats: runs of each step
    :param kept: steps of an earlier run with their seconds, by step, frame and settings
    :param keep: whether this run's steps join them
    """

    def __init__(self, repeats: int = 1, kept: dict[Any, tuple[Any, list[float]]] | None = None, keep: bool = False):
        self.repeats, self.kept, self.keep = repeats, {} if kept is None else kept, keep
        self.measured: dict[str, list[float]] = defaultdict(list)

    def __call__(self, step: str, work: Callable[[], Value], share: int = 1, key: Any = None) -> Value:
        """The work's value; its time is divided by ``share``."""
        if key is not None and (step, key) in self.kept:
            value, seconds = self.kept[step, key]
        else:
            # Writing, and tracing on a GPU, wait for something else than this process.
            waits = step == "write" or (step == "trace" and not traces_on_the_processor())
            now, seconds = time.perf_counter if waits else time.process_time, []
            for _ in range(self.repeats):
                started = now()
                value = work()
                seconds.append((now() - started) / share)
            if self.keep:
                self.kept[step, key] = value, seconds
        self.measured[step] += seconds
        return value

    def seconds(self) -> dict[str, float]:
        """Medians over frames and repeats, of a stage's steps together."""
        result: dict[str, float] = defaultdict(float)
        for step, every in self.measured.items():
            result[STAGE_OF[step]] += float(np.median(every))
        return dict(result)


class Look:
    """A hook of the chain: one frame under some settings.

    :param clock: times the steps
    :param index: of the frame among those that are made together
    :param rows: [R] Doppler cell of each truth row, where it is not to be the frame's own
    :param exact: the truth from the virtual sensor's whole cube
    """

    def __init__(self, settings: ChainSettings, clock: Clock, index: int, rows: Cells | None, exact: bool) -> None:
        self.settings, self.clock, self.index, self.rows, self.exact = settings, clock, index, rows, exact
        self.paths = 0
        self.cube: NDArray = np.zeros(0)
        self.cells: Cells = np.zeros(0, dtype=np.int64)

    def __call__(self, step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """The step's value under these settings; see :class:`datafactory.frame.measurement.Hook`."""
        prune_db, processing = self.settings.prune_db, self.settings.processing
        if step == "truth":
            paths, radar, cells, *others = arguments
            rows = cells if self.rows is None else self.rows
            work = partial(reference_moments if self.exact else function, paths, radar, rows, *others)
            return self.clock(step, work, key=(self.index, self.exact, prune_db, processing.truth_terms))
        if step in OF_SIGNAL:
            work = partial(function, *arguments)
            value = self.clock(step, work, key=(self.index, prune_db, processing.tolerance))
        else:
            value = function(*arguments)
        if step == "prune":
            self.paths = len(value)
        elif step == "cube":
            self.cube = value
        elif step == "Doppler choice":
            self.cells = value.cells[0]
        return value


@dataclass(frozen=True, eq=False)
class Outcome:
    """Frames made under some settings.

    :param paths: of each frame, after pruning
    :param cubes: [chirps, samples, channels] of each frame
    :param cells: [R] first Doppler cell of each row and frame
    :param images: [B, R, U] magnitudes [sqrt(W)]
    :param frames: what a run would write
    """

    paths: tuple[int, ...]
    cubes: tuple[NDArray, ...]
    cells: tuple[Cells, ...]
    images: NDArray[np.float32]
    frames: tuple[Frame, ...]


def made(
    frames: Sequence[TracedFrame],
    settings: ChainSettings,
    radar: Radar,
    clock: Clock | None = None,
    rows: Sequence[Cells] | None = None,
    batch: int = 1,
    exact: bool = False,
) -> Outcome:
    """All stages after tracing.

    :param clock: times them
    :param rows: [R] Doppler cells of each frame's truth, so that image errors are the image's own; each frame's own
        without
    :param batch: frames whose images share their time
    :param exact: see :class:`Look`
    """
    clock = clock or Clock()
    looks = [Look(settings, clock, index, rows[index] if rows else None, exact) for index in range(len(frames))]
    measurements = [
        measured(TracedSource(frame, settings), radar, look) for frame, look in zip(frames, looks, strict=True)
    ]
    images: list[NDArray[np.float32]] = []
    truth = (exact, settings.prune_db, settings.processing.truth_terms)

    def at(step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        moments, *others = arguments
        padded = np.zeros((max(batch, len(moments)), *moments.shape[1:]), dtype=np.complex64)
        padded[: len(moments)] = moments
        value = clock(step, partial(function, padded, *others), share=batch, key=truth)[: len(moments)]
        images.append(np.abs(value))
        return value

    written = tuple(frame for frame, _ in image(measurements, radar, at))
    return Outcome(
        paths=tuple(look.paths for look in looks),
        cubes=tuple(look.cube for look in looks),
        cells=tuple(look.cells for look in looks),
        images=images[0],
        frames=written,
    )


def reference_of(
    frames: Sequence[TracedFrame], settings: ChainSettings, radar: Radar, rows: Sequence[Cells] | None = None
) -> Outcome:
    """The converged frames: what every setting on the same paths is held against.

    :param settings: of which tolerance, pruning and truth give way
    :param rows: see :func:`made`
    """
    return made(frames, KnobSettings.of(settings).reference().on(settings), radar, rows=rows, exact=True)


def reference_moments(
    paths: PathTable, radar: Radar, doppler_cells: Cells, terms: int, intra_chirp: bool = False
) -> NDArray[np.complex64]:
    """[terms, R, C] what :func:`datafactory.synthesis.truth.truth_moments` approximates: from the virtual sensor's
    whole cube and Doppler filters."""
    waveform, sensor = radar.waveform, radar.virtual_sensor
    window = unit_hann(waveform.chirps)
    turn = np.arange(waveform.chirps) / waveform.chirps
    moments = np.empty((terms, waveform.range_bins, sensor.channels), dtype=np.complex64)
    for first in range(0, len(sensor.rx_m), REFERENCE_BLOCK):
        block = slice(first, first + REFERENCE_BLOCK)
        some = AntennaArray(tx_m=sensor.tx_m, rx_m=sensor.rx_m[block])
        cube = cube_of_paths(paths, radar, REFERENCE_TOLERANCE, some, intra_chirp=intra_chirp)
        for cell in np.unique(doppler_cells):
            rows = np.flatnonzero(doppler_cells == cell)
            weight = window * np.exp(-2j * np.pi * (cell - waveform.chirps // 2) * turn)
            filtered = np.tensordot(weight.astype(cube.dtype), cube, axes=1)
            moments[:, rows, block] = sweep_moments(filtered, radar, terms)[:, rows]
    return moments


def write_seconds(frame: Frame, radar: Radar, repeats: int) -> float:
    """Median seconds to write one frame as a shard, flushed to the disk."""
    schema = arrow_schema(description(radar, len(frame.velocity), "range-channel"))
    clock = Clock(repeats)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "train", "part-00000.parquet")
        clock("write", partial(write_shard, path, [frame], schema))
    return clock.seconds()["write"]
