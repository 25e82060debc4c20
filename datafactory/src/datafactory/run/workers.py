"""Shards in worker processes, or in this one: hand out, watch, record. The processes are the standard library's."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.job import Job, WriteShard
from datafactory.run.progress import FinishedShard, record_finished
from datafactory.run.shards import ShardPlan

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class Work:
    """What every worker is given once.

    :param write: makes one shard of the job
    :param mark: of the arguments, see :func:`datafactory.run.progress.fingerprint`
    """

    job: Job
    write: WriteShard
    directory: Path
    mark: str

    def begin(self) -> None:
        """Make this process ready."""
        if self.job.scenes:
            select_variant()
            set_threads(1)

    def shard(self, plan: ShardPlan, report: Callable[[int], None]) -> tuple[FinishedShard, dict[str, float]]:
        """Write one shard."""
        return self.write(self.job, plan, self.directory, self.mark, report)


def run_shards(
    work: Work, todo: Sequence[ShardPlan], workers: int, total: int, advance: Advance
) -> tuple[dict[ShardPlan, FinishedShard], dict[str, float]]:
    """Write the shards; each is recorded as soon as it is whole.

    One worker, or one shard, is worked on in this process: a script needs no guard around its main part.

    :param total: frames of the run; :param advance: takes frames done and frames in all
    """
    progress = _Progress(work.directory, total - sum(len(plan.frame_ids) for plan in todo), total, advance)
    if min(workers, len(todo)) <= 1:
        work.begin()
        for plan in todo:
            progress.finished(plan, *work.shard(plan, progress.frames))
    else:
        _in_processes(work, todo, min(workers, len(todo)), progress)
    return progress.made, dict(progress.seconds)


class _Progress:
    """What is done so far."""

    def __init__(self, directory: Path, done: int, total: int, advance: Advance) -> None:
        self.directory, self.done, self.total, self.advance = directory, done, total, advance
        self.made: dict[ShardPlan, FinishedShard] = {}
        self.seconds: Counter[str] = Counter()
        advance(done, total)

    def frames(self, count: int) -> None:
        self.done += count
        self.advance(self.done, self.total)

    def finished(self, plan: ShardPlan, shard: FinishedShard, seconds: dict[str, float]) -> None:
        record_finished(self.directory, plan, shard)
        self.made[plan] = shard
        self.seconds.update(seconds)


def _in_processes(work: Work, todo: Sequence[ShardPlan], workers: int, progress: _Progress) -> None:
    context = multiprocessing.get_context("spawn")
    ticks = context.SimpleQueue()
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_start, initargs=(work, ticks)) as pool:
        pending: dict[Future, ShardPlan] = {pool.submit(_shard, plan): plan for plan in todo}
        try:
            while pending:
                finished, _ = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                while not ticks.empty():
                    progress.frames(ticks.get())
                for future in finished:
                    progress.finished(pending.pop(future), *future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_given: dict[str, Any] = {}
"""What a worker process was given at its start; a process pool hands tasks nothing else."""


def _start(work: Work, ticks: Any) -> None:
    work.begin()
    _given.update(work=work, ticks=ticks)


def _shard(plan: ShardPlan) -> tuple[FinishedShard, dict[str, float]]:
    return _given["work"].shard(plan, _given["ticks"].put)
