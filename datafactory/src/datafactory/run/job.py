"""What a worker process does: frames from the deal to the rows of a shard."""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeVar

import pyarrow as pa
from threadpoolctl import threadpool_limits

from datafactory.frame.chain import ChainSettings, PointSource, SceneSource, Source, StoredSource, make_frames
from datafactory.frame.deal import Deal, PreparedScene
from datafactory.frame.measurement import Hook
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.solver import load_solver
from datafactory.paths.storage import to_row, writer_options
from datafactory.run.memory import Load, keep_freed_memory
from datafactory.run.shards import PATHS, Portion, ShardPlan, frame_options, plan_shards
from shared.dataset import to_record_batch
from shared.radar import Radar

Value = TypeVar("Value")


@dataclass(frozen=True)
class Job:
    """Everything that determines the frames' bytes.

    :param deal: which frame is which
    :param scenes: those that are traced; none where paths were traced before
    :param settings: of point frames; :param of_scenes: of scene frames
    :param schema_message: Arrow's schema message; a pickled :class:`pyarrow.Schema` forgets that the elements of its
        lists are never null, which would cost every reader a quarter of its time
    :param paths_alone: whether the rows are traced paths; otherwise frames
    """

    radar: Radar
    deal: Deal
    scenes: tuple[PreparedScene, ...]
    settings: ChainSettings
    of_scenes: ChainSettings
    schema_message: bytes
    paths_alone: bool

    @property
    def plans(self) -> tuple[ShardPlan, ...]:
        """The shards of the whole dataset."""
        return plan_shards((PATHS,) * len(self.deal) if self.paths_alone else self.deal.splits())

    @property
    def schema(self) -> pa.Schema:
        """Of the shards."""
        return pa.ipc.read_schema(pa.py_buffer(self.schema_message))

    @property
    def shard_options(self) -> dict[str, Any]:
        """How its shards are written, see :func:`datafactory.run.shards.write_tables`."""
        return writer_options() if self.paths_alone else frame_options(self.schema)

    @property
    def load(self) -> Load:
        """What decides over the memory of a process that makes its frames."""
        triangles = sum(len(mesh.triangles) for scene in self.scenes for mesh in scene.merged.meshes)
        rays = self.settings.trace.rays if self.deal.stored else 0
        return Load(self.radar, self.settings, triangles, traced=bool(self.scenes), stored_rays=rays)

    def source(self, frame_id: int) -> Source:
        """Where a frame comes from."""
        frame = self.deal.frame(frame_id)
        if frame.kind == "points":
            return PointSource(frame, self.settings)
        if frame.stored is not None:
            return StoredSource(frame.stored, self.of_scenes)
        return SceneSource(frame, self.scenes[frame.scene], self.of_scenes)

    def rows(self, frame_ids: Sequence[int], at: Hook) -> Iterator[tuple[pa.RecordBatch, Counter[str]]]:
        """The frames' rows in their order, one a batch, each with what its frame counted.

        :param at: called at every step, see :mod:`datafactory.frame.chain`
        """
        schema, sources = self.schema, map(self.source, frame_ids)
        if not self.paths_alone:
            for frame, counts in make_frames(sources, self.radar, at):
                yield to_record_batch([frame], schema), counts
            return
        for source in sources:
            assert isinstance(source, SceneSource)  # only scenes are traced
            traced = source.traced(self.radar, at)
            counts = Counter({**traced.table.counts, "frames": 1, "paths": len(traced.table)})
            yield pa.RecordBatch.from_pylist([to_row(traced)], schema=schema), counts


@dataclass
class StepSeconds:
    """A hook of the chain that adds up seconds by step."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def __call__(self, step: str, function: Callable[..., Value], *arguments: object) -> Value:
        started = time.perf_counter()
        value = function(*arguments)
        self.seconds[step] += time.perf_counter() - started
        return value


@dataclass(frozen=True)
class Rows:
    """What was made of a portion.

    :param file: its rows as a stream of Arrow's, one record batch a frame
    :param counts: of its frames, added up
    :param seconds: of each step
    """

    file: Path
    counts: dict[str, int]
    seconds: dict[str, float]


@dataclass(frozen=True)
class PortionWork:
    """What every worker is given once.

    :param folder: for the files of rows
    """

    job: Job
    folder: Path

    def begin(self) -> None:
        """Make this process ready."""
        make_ready(self.job.settings.device if self.job.scenes else None)

    def __call__(self, portion: Portion) -> Rows:
        """Make one portion."""
        with new_file(self.folder, portion) as file, file.open("wb") as sink:
            return Rows(file, *self.write(portion, sink))

    def write(self, portion: Portion, sink: IO[bytes] | pa.NativeFile) -> tuple[dict[str, int], dict[str, float]]:
        """Make one portion's rows; returns counts and seconds, see :class:`Rows`."""
        counts, hook, started = Counter[str](), StepSeconds(), time.perf_counter()
        with threadpool_limits(limits=1), pa.ipc.new_stream(sink, self.job.schema) as stream:
            for row, counted in self.job.rows(portion.frame_ids, hook):
                counts.update(counted)
                stream.write_batch(row)
        rest = time.perf_counter() - started - sum(hook.seconds.values())
        return dict(counts), {**hook.seconds, "between": rest}


def make_ready(device: str | None) -> None:
    """What a process needs whatever it will make: its libraries are loaded and take one core.

    :param device: that scenes are traced on; None where none are
    """
    keep_freed_memory()
    if device is not None:
        select_variant(device)
        set_threads(1)
        load_solver()


@contextmanager
def new_file(folder: Path, portion: Portion) -> Iterator[Path]:
    """A name for the rows of a portion, of this process alone: one whose run was killed may still be at work on it.

    :raises OSError: what the block raises; it names the file, which a write by itself does not
    """
    file = folder / f"{portion.plan.split}-{portion.frame_ids[0]}-{os.getpid()}.arrow"
    try:
        yield file
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), error.filename or str(file)) from error
