"""One frame through the stages under given settings, each stage timed; and the reference that it is held against.

Seconds are per frame on one core, the median over frames and repeats. Tracing and writing may wait for a device and
are timed on the wall clock; the rest in processor time, which neighbours on the machine hardly change. The image stage
works on a batch, as the pipeline does, and its time is shared by a full batch. Peak memory is the growth of the
process's resident set while a stage runs, sampled every 5 ms, over what was resident before: the stage's own arrays,
not the libraries.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil
from numpy.typing import NDArray

from datafactory.accuracy import knobs, variants
from datafactory.accuracy.knobs import Settings
from datafactory.frame.chain import IMAGE_BATCH, detected_cells
from datafactory.paths.prune import pruned
from datafactory.paths.table import PathTable
from datafactory.run.shards import write_shard
from datafactory.synthesis.cube import FLOAT32_TOLERANCE, cube_of_paths
from datafactory.synthesis.truth import truth_moments
from shared.dataset import Frame, arrow_schema, description
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum, near_field_images
from shared.signal.spectrum import DopplerSelection, range_doppler, select_doppler
from shared.signal.windows import angle_window, cell_noise_power

STAGES = ("trace", "delays and spread", "range-Doppler", "truth", "image", "write")
WAITING = ("trace", "write")
SAMPLING_S = 0.005
Value = TypeVar("Value")


@contextmanager
def peak_memory() -> Iterator[Callable[[], float]]:
    """Yields a function that tells the growth of the resident set so far [MB]."""
    process, done = psutil.Process(), threading.Event()
    before = process.memory_info().rss
    highest = [before]

    def watch() -> None:
        while not done.wait(SAMPLING_S):
            highest[0] = max(highest[0], process.memory_info().rss)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield lambda: (max(highest[0], process.memory_info().rss) - before) / 1e6
    finally:
        done.set()
        watcher.join()


@dataclass(frozen=True)
class _Measured:
    value: Any
    seconds: tuple[float, ...]
    peak_mb: float


class Clock:
    """Seconds and peak memory by stage; a stage whose settings the kept run shares is not run again.

    :param repeats: runs of each call
    :param kept: stages of an earlier run, by stage, settings and frame
    :param keep: whether this run's stages join them
    """

    def __init__(self, repeats: int = 1, kept: dict[Any, _Measured] | None = None, keep: bool = False) -> None:
        self.repeats, self.kept, self.keep = repeats, {} if kept is None else kept, keep
        self.measured: dict[str, list[_Measured]] = defaultdict(list)

    def __call__(self, stage: str, work: Callable[[], Value], share: int = 1, key: Any = None) -> Value:
        """The work's value; its time is divided by ``share``."""
        found = self.kept.get((stage, key)) if key is not None else None
        if found is None:
            seconds = []
            now = time.perf_counter if stage in WAITING else time.process_time
            with peak_memory() as peak:
                for _ in range(self.repeats):
                    started = now()
                    value = work()
                    seconds.append((now() - started) / share)
                found = _Measured(value, tuple(seconds), peak())
            if self.keep:
                self.kept[stage, key] = found
        self.measured[stage].append(found)
        return found.value

    def seconds(self) -> dict[str, float]:
        """Medians over frames and repeats."""
        return {
            stage: float(np.median([s for m in every for s in m.seconds])) for stage, every in self.measured.items()
        }

    def peak_mb(self) -> float:
        return max(item.peak_mb for every in self.measured.values() for item in every)


def at_rest_or_not(paths: PathTable, settings: Settings, radar: Radar) -> PathTable:
    """The paths as they move, or as they stand at mid-frame where there is no Doppler."""
    return paths if settings.effects.doppler else paths.at_rest(radar.waveform.mid_frame_s)


def as_set(paths: PathTable, settings: Settings, radar: Radar) -> PathTable:
    """The paths that the settings leave, with the delay law that they ask for."""
    kept = at_rest_or_not(pruned(paths, radar, settings.prune_db), settings, radar)
    if settings.delays == "linear":
        kept = variants.linear_delays(kept, radar)
    return variants.float32_geometry(kept) if settings.width == "float32 geometry" else kept


def cube_as_set(paths: PathTable, settings: Settings, radar: Radar) -> NDArray:
    """[chirps, samples, channels] of paths that :func:`as_set` returned."""
    tolerance = settings.tolerance
    if settings.width == "complex128":
        tolerance = min(tolerance, 0.99 * FLOAT32_TOLERANCE)
    if settings.video_phase != radar.waveform.residual_video_phase:
        waveform = radar.waveform.model_copy(update={"residual_video_phase": settings.video_phase})
        radar = radar.model_copy(update={"waveform": waveform})
    return cube_of_paths(paths, radar, tolerance, model=settings.wave_model())


def images_as_set(
    moments: Sequence[NDArray], settings: Settings, radar: Radar, size: int = IMAGE_BATCH
) -> NDArray[np.float32]:
    """[B, R, U] magnitudes of at most ``size`` frames' sweep moments, imaged as a batch of that size."""
    sensor = radar.virtual_sensor
    batch = np.zeros((size, *moments[0].shape), dtype=np.complex64)
    batch[: len(moments)] = moments
    batch *= angle_window(settings.truth_window, sensor.channels).astype(np.float32)
    if settings.truth_wave == "plane":
        images = delay_and_sum(batch[:, 0], radar.model_copy(update={"array": sensor}))
    else:
        images = near_field_images(batch, radar, sensor)
    return np.abs(images[: len(moments)])


@dataclass(frozen=True, eq=False)
class Reference:
    """The converged frames: what every setting on the same paths is held against.

    :param cubes: [chirps, samples, channels] complex128 of each frame
    :param cells: [R] first Doppler cell of each row and frame
    :param images: [B, R, U] magnitudes [sqrt(W)]
    """

    cubes: tuple[NDArray, ...]
    cells: tuple[NDArray[np.int64], ...]
    images: NDArray[np.float32]


def reference_of(tables: Sequence[PathTable], settings: Settings, radar: Radar) -> Reference:
    """The converged frames of unpruned ``tables`` under the radar's own residual video phase."""
    cubes, cells, moments = [], [], []
    model = settings.wave_model()
    for table in tables:
        paths = at_rest_or_not(table, settings, radar)
        cubes.append(cube_of_paths(paths, radar, knobs.REFERENCE_TOLERANCE, model=model))
        cells.append(selection_of(cubes[-1], radar).cells[0])
        moments.append(variants.reference_moments(paths, radar, cells[-1], knobs.REFERENCE_TERMS, model=model))
    return Reference(tuple(cubes), tuple(cells), images_as_set(moments, settings, radar))


def selection_of(cube: NDArray, radar: Radar) -> DopplerSelection:
    """The Doppler choice on the noise-free cube, with the threshold of the radar's noise."""
    return select_doppler(range_doppler(cube.astype(np.complex64, copy=False), radar), cell_noise_power(radar))


@dataclass(frozen=True, eq=False)
class Outcome:
    """Frames made under some settings.

    :param paths: kept, by frame
    :param cubes: as in :class:`Reference`; empty where only truths were asked for
    :param images: truths in the reference's Doppler cells where there is a reference, else in their own
    :param cells: as in :class:`Reference`
    """

    paths: tuple[int, ...]
    cubes: tuple[NDArray, ...]
    cells: tuple[NDArray[np.int64], ...]
    images: NDArray[np.float32]

    def detections(self, radar: Radar) -> list[NDArray[np.bool_]]:
        return [detected_cells(image, cell_noise_power(radar)) for image in self.images]


def run(
    tables: Sequence[PathTable],
    settings: Settings,
    radar: Radar,
    clock: Clock,
    reference: Reference | None = None,
    batch: int = IMAGE_BATCH,
) -> Outcome:
    """All stages after tracing. Doppler cells are those of the reference, so that image errors are the image's own."""
    cubes, cells, moments, counts = [], [], [], []
    s = settings
    geometry = (s.prune_db, s.delays, s.width == "float32 geometry", s.effects)
    signal = (*geometry, s.width, s.tolerance, s.video_phase)
    for index, table in enumerate(tables):
        paths = as_set(table, s, radar)
        counts.append(len(paths))
        cube = clock("delays and spread", partial(cube_as_set, paths, s, radar), key=(index, signal))
        selection = clock("range-Doppler", partial(selection_of, cube, radar), key=(index, signal))
        rows = selection.cells[0] if reference is None else reference.cells[index]
        truth = (index, *geometry, s.truth_terms)
        imaged = partial(truth_moments, paths, radar, rows, s.truth_terms, s.wave_model())
        moments.append(clock("truth", imaged, key=truth))
        cubes.append(cube)
        cells.append(selection.cells[0])
    key = (*geometry, s.truth_terms, s.truth_wave, s.truth_window)
    images = clock("image", partial(images_as_set, moments, s, radar, batch), share=batch, key=key)
    return Outcome(tuple(counts), tuple(cubes), tuple(cells), images)


def write_seconds(cube: NDArray, image: NDArray[np.float32], radar: Radar, repeats: int) -> float:
    """Median seconds to write one frame as a shard, flushed to the disk."""
    selection, peak = selection_of(cube, radar), float(image.max())
    schema = arrow_schema(description(radar, 3, "range-channel"))
    frame = Frame(
        0, "scene", "accuracy", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0),
        range_channel=selection.range_channel,
        velocity=radar.waveform.velocities_mps[selection.cells].astype(np.float32),
        image=image / np.float32(peak) if peak > 0.0 else image,
        image_peak=peak,
        noise_power=0.0,
        targets=(),
    )  # fmt: skip
    clock = Clock(repeats)
    with tempfile.TemporaryDirectory() as folder:
        clock("write", lambda: _write(Path(folder, "train", "part-00000.parquet"), frame, schema))
    return clock.seconds()["write"]


def _write(path: Path, frame: Frame, schema: Any) -> None:
    write_shard(path, [frame], schema)
