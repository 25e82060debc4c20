"""What makes frames, and where: a job, the work of a process on it, and processes of this machine, of a Ray cluster, or
this one.

Workers take portions, neighbouring frames of one shard, and hand over rows. This process writes the shards. Their bytes
do not depend on where frames are made.
"""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

import pyarrow as pa
from threadpoolctl import threadpool_limits

from datafactory.defaults import LOCAL, RAY
from datafactory.frame.chain import ChainSettings, PointSource, SceneSource, Source, StoredSource, make_frames
from datafactory.frame.deal import Deal, PreparedScene
from datafactory.frame.measurement import Hook
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.solver import load_solver
from datafactory.paths.storage import to_row, writer_options
from datafactory.run.memory import Load
from datafactory.run.progress import FinishedShard, record_finished
from datafactory.run.shards import Portion, ShardPlan, frame_options, write_tables
from shared.dataset import to_record_batch
from shared.dataset.locations import Location
from shared.physics.errors import InputError
from shared.processes.machine import keep_freed_memory
from shared.processes.pool import Pool, Processes, ThisProcess, WorkerPool
from shared.processes.telling import Announce
from shared.radar import Radar

Value = TypeVar("Value")


@dataclass(frozen=True)
class Job:
    """Everything that determines the frames' bytes.

    :param deal: which frame is which
    :param scenes: those that are traced; none where paths were traced before
    :param settings: of point frames; :param of_scenes: of scene frames, those of their trace where it was before
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
    def load(self) -> Load:
        """What decides over the memory of a process that makes its frames."""
        triangles, stored = sum(scene.triangles for scene in self.scenes), bool(self.deal.stored)
        return Load(self.radar, self.of_scenes, triangles, bool(self.scenes), not self.paths_alone, stored)

    @property
    def schema(self) -> pa.Schema:
        """Of the shards."""
        return pa.ipc.read_schema(pa.py_buffer(self.schema_message))

    @property
    def shard_options(self) -> dict[str, Any]:
        """How its shards are written, see :func:`datafactory.run.shards.write_tables`."""
        return writer_options() if self.paths_alone else frame_options(self.schema)

    def source(self, frame_id: int) -> Source:
        """Where a frame comes from."""
        frame = self.deal.frame(frame_id)
        if frame.kind == "points":
            return PointSource(frame, self.settings)
        if frame.stored is not None:
            return StoredSource(frame.stored, frame.seed, self.of_scenes)
        return SceneSource(frame, self.scenes[frame.scene], self.of_scenes)

    def rows(self, frame_ids: Sequence[int], at: Hook) -> Iterator[tuple[pa.RecordBatch, Counter[str]]]:
        """The frames' rows in their order, one a batch, each with what its frame counted.

        :param at: called at every step, see :mod:`datafactory.frame.chain`
        """
        schema, sources = self.schema, [self.source(frame_id) for frame_id in frame_ids]
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


POLL_S = 1.0
"""Longest wait for a portion before the next look."""


class RunFailed(Exception):
    """A run that cannot be finished now, in one line."""


class Writer:
    """Puts rows in order and writes shards; each is noted as soon as it is whole.

    Rows wait for the others of their shard, in their files. As portions are handed out in their order, no more shards
    wait than portions are at work.

    :param mark: of the arguments, see :func:`shared.dataset.documents.digest`
    """

    def __init__(self, job: Job, directory: Location, mark: str) -> None:
        self._job, self._directory, self._mark = job, directory, mark
        self._waiting: defaultdict[ShardPlan, dict[Portion, Rows]] = defaultdict(dict)
        self.shards: dict[ShardPlan, FinishedShard] = {}
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def take(self, portion: Portion, rows: Rows) -> None:
        """Keep the rows of a portion, and write its shard if they were the last.

        :raises OSError: the disk or the store fails
        """
        for step, seconds in rows.seconds.items():
            self.seconds[step] += seconds
        waiting = self._waiting[portion.plan]
        waiting[portion] = rows
        if sum(len(item.frame_ids) for item in waiting) == len(portion.plan.frame_ids):
            started = time.perf_counter()
            del self._waiting[portion.plan]
            self._write(portion.plan, [waiting[item] for item in sorted(waiting, key=lambda item: item.frame_ids)])
            self.seconds["write"] += time.perf_counter() - started

    def _write(self, plan: ShardPlan, in_order: Sequence[Rows]) -> None:
        counts = Counter[str]()
        for rows in in_order:
            counts.update(rows.counts)
        tables = _tables([rows.file for rows in in_order])
        record = write_tables(self._directory / plan.path, tables, self._job.schema, **self._job.shard_options)
        finished = FinishedShard(record=record, counts=dict(counts), fingerprint=self._mark)
        record_finished(self._directory, plan, finished)
        self.shards[plan] = finished
        for rows in in_order:
            rows.file.unlink()


def _tables(files: Iterable[Path]) -> Iterator[pa.Table]:
    """The rows of files, one read at a time."""
    for file in files:
        with file.open("rb") as source, pa.ipc.open_stream(source) as stream:
            for row in stream:
                yield pa.Table.from_batches([row])


def deal_out(
    portions: Sequence[Portion],
    pool: Pool[Portion, Rows],
    writer: Writer,
    keep_going: bool,
    advance: Callable[[int], None],
) -> None:
    """Have the portions made, and their shards written.

    :param pool: that works on them, see :mod:`shared.processes.pool`
    :param keep_going: finish the other shards where three processes died of a portion
    :param advance: takes frames that are left
    :raises RunFailed: three processes died of a portion
    """
    waiting, failed = deque(portions), dict[Portion, str]()
    left = sum(len(portion.frame_ids) for portion in portions)
    advance(left)
    with pool:
        while waiting or pool.busy:
            while waiting and pool.has_room:
                pool.submit(waiting.popleft())
            for finished in pool.finished(POLL_S):
                portion = finished.item
                if finished.result is not None:
                    writer.take(portion, finished.result)
                    left -= len(portion.frame_ids)
                    advance(left)
                    continue
                failed[portion] = finished.failure
                if not keep_going:
                    raise RunFailed(failure_line(failed))
                waiting = deque(item for item in waiting if item.plan != portion.plan)  # it cannot become whole
    if failed:
        raise RunFailed(failure_line(failed))


def failure_line(failed: dict[Portion, str]) -> str:
    """What to say of portions whose processes died, see :class:`shared.processes.pool.Attempts`."""
    (portion, how), *others = failed.items()
    shards = {item.plan for item, _ in others} - {portion.plan}
    more = f" (and {len(shards)} other shards)" if shards else ""
    first, last = portion.frame_ids[0], portion.frame_ids[-1]
    frames = f"frame {first}" if first == last else f"frames {first} to {last}"
    return (
        f"{portion.plan.path}, {frames}: {how}{more}, "
        "perhaps for lack of memory; the same command with --resume, and fewer --workers, goes on"
    )


class Engine:
    """Gives a run its pool: processes of this machine, or of a cluster (:mod:`datafactory.run.cluster.engine`)."""

    name = LOCAL
    """One of :data:`datafactory.defaults.ENGINES`."""

    def __init__(self) -> None:
        self._processes = Processes()

    @contextmanager
    def ahead(self, count: int, device: str | None) -> Iterator[None]:
        """A block in which processes of this machine get ready while scenes are opened; those not needed end with it.

        :param count: that may be wanted; none is begun for one: that is this process
        :param device: that scenes are traced on; None where none are
        """
        with Processes(partial(make_ready, device)) as self._processes:
            self._processes.start(count if count > 1 else 0)
            yield

    def at_a_time(self, workers: int) -> int:
        """Processes that make frames at a time, wherever they are.

        :param workers: as :attr:`datafactory.run.pipeline.Execution.workers`
        """
        return workers

    def pool(self, work: PortionWork, portions: int, workers: int) -> Pool[Portion, Rows]:
        """A pool for so many portions; for one worker, or one portion, this process: a script needs no guard then."""
        count = min(workers, portions)
        if count <= 1:
            return ThisProcess[Portion, Rows](work)
        return WorkerPool[Portion, Rows](work, count, work.folder / "pool", self._processes)


@contextmanager
def opened(name: str, address: str | None, announce: Announce) -> Iterator[Engine]:
    """An engine that is ready to work; its connection, where it has one, ends with the block.

    :param name: one of :data:`datafactory.defaults.ENGINES`
    :param address: HOST:PORT of a Ray cluster; None for the one that this machine is a node of, or one for this run
    :param announce: takes lines for the user
    :raises InputError: an address without Ray, Ray not installed, a cluster that cannot be reached or worked with
    """
    if name == RAY:
        from datafactory.run.cluster.engine import connected

        with connected(address, announce) as engine:
            yield engine
    elif address is not None:
        raise InputError("--address", f"{address!r} with --engine {name}", f"--engine {RAY}")
    else:
        yield Engine()
