"""Shards in worker processes: hand out, watch, record. The processes are those of the standard library's pool."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.job import Job
from datafactory.run.progress import FinishedShard, record_finished
from datafactory.run.shards import ShardPlan


def run_shards(
    job: Job,
    write: Callable[..., Any],
    todo: list[ShardPlan],
    directory: Path,
    mark: str,
    workers: int,
    total: int,
    advance: Callable[[int, int], None],
) -> tuple[dict[ShardPlan, FinishedShard], dict[str, float]]:
    """Write the shards in worker processes; each is recorded as soon as it is whole."""
    context = multiprocessing.get_context("spawn")
    ticks = context.SimpleQueue()
    made: dict[ShardPlan, FinishedShard] = {}
    seconds: Counter[str] = Counter()
    done = total - sum(len(plan.frame_ids) for plan in todo)
    advance(done, total)
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start, initargs=(job, write, directory, mark, ticks)
    ) as pool:
        pending: dict[Future, ShardPlan] = {pool.submit(_render, plan): plan for plan in todo}
        try:
            while pending:
                finished, _ = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                while not ticks.empty():
                    done += ticks.get()
                    advance(done, total)
                for future in finished:
                    plan = pending.pop(future)
                    made[plan], spent = future.result()
                    record_finished(directory, plan, made[plan])
                    seconds.update(spent)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return made, dict(seconds)


_state: dict[str, Any] = {}
"""What a worker process was given at its start; a process pool hands tasks nothing else."""


def _start(job: Job, write: Callable[..., Any], directory: Path, mark: str, ticks: Any) -> None:
    if job.scenes:
        select_variant()
        set_threads(1)
    _state.update(job=job, write=write, directory=directory, mark=mark, ticks=ticks)


def _render(plan: ShardPlan) -> tuple[FinishedShard, dict[str, float]]:
    return _state["write"](_state["job"], plan, _state["directory"], _state["mark"], _state["ticks"].put)
