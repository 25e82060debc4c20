"""Whether a run fits into memory and onto the disk, said before it is begun.

Memory is that of a worker for its scenes, rays and radar, and of all together. What is counted is what was measured to
matter (``tests/benchmarks/worker_memory.py``, docs/large-runs.md): libraries and the kernels that they compile,
triangles, rays, the arrays of a cube, and what a batch of frames keeps until its images are made. Every figure is an
upper one: what is measured lies between a third of the prediction and all of it.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from datafactory.defaults import CPU, CUDA, IMAGE_BATCH
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.run.shards import FRAMES_PER_SHARD
from shared.dataset import description, row_bytes
from shared.dataset.folder import SPLITS
from shared.dataset.locations import Location, RemotePath, file_size
from shared.physics.errors import InputError
from shared.processes.machine import may_start_processes, usable_cores, usable_memory
from shared.processes.telling import Announce, silent
from shared.radar import Radar
from shared.signal.imaging import walk_terms

BASE_BYTES = 500e6
"""A process that makes frames, before the first: the interpreter, its libraries, compiled kernels."""
TRACER_BYTES = 450e6
"""Mitsuba, Dr.Jit, Sionna and LLVM, with the programs that they compile for a scene."""
TRIANGLE_BYTES = 3_000.0
"""Of a triangle: the merged scene, the tracer's own, and neighbours, edges and curved surfaces that are found once."""
RAY_BYTES = {1: 400.0, 2: 1_300.0, 3: 1_900.0}
"""Of a ray, by the largest number of bounces: the solver's room for paths, and the paths themselves."""
CUBES = 5.5
"""Arrays of a cube's size at a time: the cube, the noise on it, its spectra in two orders."""
KEPT_CUBES = 2.0
"""Of a frame that keeps its cube, until its portion is made."""
WRITTEN_CUBES = 4.0
"""Of the row that the command's process reads and writes."""
LARGE = 0.5
"""Share of the memory from which on a run says what it will take."""


# What a frame needs on the disk at the very least: a run that this refuses cannot fit.
COMPRESSED = 0.005
"""Share of an array's bytes: empty frames without noise take 0.007 of theirs."""
NOISY = {"range_channel": 0.6, "range_doppler": 0.7, "cube": 0.2}
"""The same of arrays with receiver noise, of whose bytes LZ4 finds few alike; of ``range_channel`` for one Doppler
peak, for the others repeat it where there are no more. Measured in scenes, a bare plane and close targets with 1 to 128
chirps, 1 to 256 channels and noise figures of 0 to 60 dB: at least 0.91, 0.75 and 0.83. Of one standing target of 60
dBsm at 1 m, the same in every chirp: 0.84, 0.81 and 0.41 where its echo is 100 dB above the noise of a sample, and 0.31
at 137 dB; in float32 there is no noise 150 dB below. A converter may swallow all of it."""
FRAME_BYTES = 4_000.0
"""Of a frame's headers, and its share of what its shard says of itself; measured in full shards: 6400."""
STREETS, CLOSE_TARGETS = 0.82, 0.19
"""Share of its arrays' bytes that a frame with noise takes on the disk, in streets and of close targets."""


@dataclass(frozen=True)
class Load:
    """What decides over the memory of a run.

    :param triangles: of all its scenes
    :param traced: whether scenes are traced
    :param rendered: whether cubes are made; paths alone otherwise
    :param stored: whether paths were traced before, as the settings say
    """

    radar: Radar
    settings: ChainSettings
    triangles: int = 0
    traced: bool = False
    rendered: bool = True
    stored: bool = False

    @property
    def worker_bytes(self) -> float:
        """Peak of a process that makes frames."""
        return BASE_BYTES + self._tracer_bytes + self._ray_bytes + (self._signal_bytes if self.rendered else 0.0)

    @property
    def parent_bytes(self) -> float:
        """Peak of the process that hands out portions to others and writes shards."""
        written = WRITTEN_CUBES * self._cube_bytes if self._keeps_cubes else 0.0
        return BASE_BYTES + self._tracer_bytes + written

    def total_bytes(self, workers: int) -> float:
        """Of so many workers; one works in the process that hands out."""
        return self.worker_bytes if workers == 1 else workers * self.worker_bytes + self.parent_bytes

    @property
    def _tracer_bytes(self) -> float:
        return TRACER_BYTES + TRIANGLE_BYTES * self.triangles if self.traced else 0.0

    @property
    def _ray_bytes(self) -> float:
        trace = self.settings.trace
        return RAY_BYTES[trace.depth] * trace.rays if self.traced or self.stored else 0.0

    @property
    def _keeps_cubes(self) -> bool:
        return self.rendered and self.settings.processing.store == "cube"

    @property
    def _cube_bytes(self) -> float:
        waveform = self.radar.waveform
        return 8.0 * waveform.chirps * waveform.samples * self.radar.array.channels

    @property
    def _signal_bytes(self) -> float:
        waveform, grid, elements = self.radar.waveform, self.radar.grid, self.radar.virtual_sensor.channels
        processing = self.settings.processing
        cube = self._cube_bytes
        terms = walk_terms(self.radar, processing.truth_terms)
        moments = 8.0 * terms * waveform.range_bins * elements
        image = 8.0 * waveform.range_bins * grid.bins
        kept = moments + image + (KEPT_CUBES * cube if self._keeps_cubes else 0.0)
        matrices = 8.0 * terms * grid.bins * elements
        return CUBES * cube + IMAGE_BATCH * kept + matrices


def workers_for(load: Load, asked: int, announce: Announce = silent) -> int:
    """Worker processes of a run: those asked for, or for 0 as many as there are cores and memory for.

    What is large is announced.

    :raises InputError: what was asked for, or one process, does not fit; with both figures and what would fit
    """
    limit = usable_memory()
    workers = processes(asked, load.settings.device)
    fitting = most_workers(load, limit)
    if fitting < (asked or 1):
        raise _too_much(load, asked or 1, limit, fitting)
    if not asked and fitting < workers:
        workers = fitting
        announce(f"{_processes(workers)}, as there is memory for no more: {statement(load, workers, limit)}")
    elif load.total_bytes(workers) > LARGE * limit:
        announce(statement(load, workers, limit))
    return workers


def processes(workers: int, device: str = CPU) -> int:
    """``workers``, or for 0 the cores that this process may use; with CUDA one, for a run has one GPU, and one where
    this process may start no others."""
    return workers or (1 if device == CUDA or not may_start_processes() else usable_cores())


def processes_ahead(workers: int, device: str) -> int:
    """As :func:`processes`, before it is known what a process takes: as many as there is memory for their libraries."""
    return min(processes(workers, device), int(usable_memory() // BASE_BYTES))


def most_workers(load: Load, limit: float) -> int:
    """How many workers fit into so many bytes; 0 for none."""
    if load.total_bytes(1) > limit:
        return 0
    return max(1, int((limit - load.parent_bytes) // load.worker_bytes))


def rays_that_fit(load: Load, limit: float) -> int:
    """How many rays a frame may have for one worker to fit into so many bytes; 0 or less for none."""
    trace = load.settings.trace
    without = replace(load, settings=replace(load.settings, trace=replace(trace, rays=0)))
    of_ray = (load.total_bytes(1) - without.total_bytes(1)) / max(trace.rays, 1)
    return int((limit - without.total_bytes(1)) / of_ray)


def statement(load: Load, workers: int, limit: float) -> str:
    """In words: what so many workers take."""
    of_each = "" if workers == 1 else f", {amount(load.worker_bytes)} each"
    return (
        f"about {amount(load.total_bytes(workers))} of memory in {_processes(workers)}{of_each}; "
        f"{amount(limit)} may be used here"
    )


def amount(size: float) -> str:
    """Bytes in words."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def _processes(count: int) -> str:
    return "1 process" if count == 1 else f"{count} processes"


def _too_much(load: Load, workers: int, limit: float, fitting: int) -> InputError:
    needed = statement(load, workers, limit)
    if fitting:
        return InputError("--workers", f"{workers} take {needed}", f"at most {fitting}")
    rays = rays_that_fit(load, limit) if load.traced else 0
    if rays > 0:
        return InputError("--rays", f"{load.settings.trace.rays} take {needed}", f"at most {rays}")
    radar = "fewer samples, chirps or channels, " if load.rendered else ""
    return InputError("memory", f"one frame takes {needed}", f"{radar}a smaller scene, or a larger machine")


def free_bytes(directory: Location) -> int:
    """Free on the disk of a folder, or of the nearest above it that exists; for a remote one, where shards are made
    before they are sent."""
    if isinstance(directory, RemotePath):
        return shutil.disk_usage(tempfile.gettempdir()).free
    return shutil.disk_usage(
        next(folder for folder in (directory, *directory.absolute().parents) if folder.is_dir())
    ).free


def frame_bytes(radar: Radar, processing: Processing) -> int:
    """Of a frame's arrays, before they are compressed."""
    return row_bytes(description(radar, processing.peaks, processing.store)["shapes"])


def least_bytes(radar: Radar, processing: Processing) -> float:
    """That a frame needs on the disk, whatever is in it."""
    shapes = description(radar, processing.peaks, processing.store)["shapes"]
    noisy = dict[str, float]()
    if processing.noise and radar.front_end.converter is None:
        noisy = NOISY | {"range_channel": NOISY["range_channel"] / processing.peaks}
    return FRAME_BYTES + sum(noisy.get(name, COMPRESSED) * row_bytes(shapes, [name]) for name in shapes)


def room(directory: Location) -> int:
    """Bytes for a run's files: those free, and those that files of the run have which are there already."""
    free = free_bytes(directory)
    if isinstance(directory, Path):
        for file in directory.rglob("*"):
            with suppress(OSError):  # one that a run has just removed
                free += file_size(file) or 0
    return free


def require_room(directory: Location, frames: int, radar: Radar, processing: Processing) -> None:
    """Refuse a run whose shards cannot fit.

    :param directory: on the disk that is meant, or a remote one, of which one shard stands here
    :param processing: of the frames with the least noise
    :raises InputError: with both figures
    """
    least, free, disk = least_bytes(radar, processing), room(directory), directory
    if isinstance(directory, RemotePath):  # of few frames each split has a part
        frames, disk = min(math.ceil(frames / len(SPLITS)), FRAMES_PER_SHARD), Path(tempfile.gettempdir())
    if frames * least > free:
        needed = math.ceil(frames * least / 1e6)  # and what is free rounded down: never the same number
        fault = f"{frames} frames need at least {needed} MB; {disk} has {int(free / 1e6)} MB free"
        raise InputError("number of frames", fault, f"at most {int(free / least)}, or another disk")
