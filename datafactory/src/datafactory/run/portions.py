"""Frames in processes, of this machine or of a Ray cluster, or in this one: hand out, put in order, write, note.

Workers take portions, neighbouring frames of one shard, and hand over rows. This process writes the shards. Their bytes
do not depend on where frames are made.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Protocol

import pyarrow as pa

from datafactory.defaults import LOCAL, RAY
from datafactory.run.job import Job, PortionWork, Rows, make_ready
from datafactory.run.progress import FinishedShard, record_finished
from datafactory.run.shards import Portion, ShardPlan, write_tables
from shared.dataset.locations import Location
from shared.physics.errors import InputError
from shared.processes.pool import Pool, Processes, ThisProcess, WorkerPool

POLL_S = 1.0
"""Longest wait for a portion before the next look."""


class RunFailed(Exception):
    """A run that cannot be finished now, in one line."""


class Writer:
    """Puts rows in order and writes shards; each is noted as soon as it is whole.

    Rows wait for the others of their shard, in their files. As portions are handed out in their order, no more shards
    wait than portions are at work.

    :param mark: of the arguments, see :func:`datafactory.run.progress.fingerprint`
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

    :param pool: that works on them, see :mod:`datafactory.run.portions`
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


class Engine(Protocol):
    """Gives a run its pool."""

    @property
    def name(self) -> str:
        """One of :data:`datafactory.defaults.ENGINES`."""

    def processes_here(self, workers: int) -> int:
        """Processes of this machine that make frames at a time; this one hands out, and counts as one.

        :param workers: as :attr:`datafactory.run.pipeline.Execution.workers`
        """

    def ahead(self, count: int, device: str | None) -> AbstractContextManager[None]:
        """A block in which processes of this machine get ready while scenes are opened; those not needed end with it.

        :param count: that may be wanted
        :param device: that scenes are traced on; None where none are
        """

    def at_a_time(self, workers: int) -> int:
        """Processes that make frames at a time, wherever they are."""

    def pool(self, work: PortionWork, portions: int, workers: int) -> Pool[Portion, Rows]:
        """A pool for so many portions."""


class Local:
    """Processes of this machine."""

    name = LOCAL

    def __init__(self) -> None:
        self._processes = Processes()

    @contextmanager
    def ahead(self, count: int, device: str | None) -> Iterator[None]:
        """None for one: that is this process."""
        with Processes(partial(make_ready, device)) as self._processes:
            self._processes.start(count if count > 1 else 0)
            yield

    def processes_here(self, workers: int) -> int:
        """All."""
        return workers

    def at_a_time(self, workers: int) -> int:
        """All."""
        return workers

    def pool(self, work: PortionWork, portions: int, workers: int) -> Pool[Portion, Rows]:
        """This process for one worker, or one portion: a script needs no guard then."""
        count = min(workers, portions)
        if count <= 1:
            return ThisProcess[Portion, Rows](work)
        return WorkerPool[Portion, Rows](work, count, work.folder / "pool", self._processes)


@contextmanager
def opened(name: str, address: str | None, announce: Callable[[str], None]) -> Iterator[Engine]:
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
        yield Local()
