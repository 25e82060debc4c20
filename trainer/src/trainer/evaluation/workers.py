"""Cells of an experiment, in this process or in several of the standard library's pool.

Every cell is computed with one thread, here and there, so that its numbers do not depend on how many are computed at a
time. A worker is sent the bench once and after that only which task of which experiment is next: it lists an
experiment's tasks for itself, and tasks that follow each other find what they share (a frame, a simulated scene)
already made.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import wait as wait_for_sentinels
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any

import torch
from threadpoolctl import threadpool_limits

from shared.physics.errors import InputError
from trainer.errors import TrainingStopped
from trainer.evaluation.experiments.bench import Bench, Experiment, Task
from trainer.evaluation.store import Values

AHEAD = 2
"""Tasks sent to each worker: the one that it computes and the next."""
GRACE_S = 2.0
"""Time that a process has to finish its cell before it is ended [s]: most cells take less."""


def cores() -> int:
    """What this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers:
    """Computes cells; a context, which ends its processes when it is left, whatever for.

    :param bench: what the cells are of; sent to each process as the first cell is asked for
    :param count: processes; 1 computes here, 0 takes one for each core
    :raises InputError: a negative count
    """

    def __init__(self, bench: Bench, count: int = 1) -> None:
        if count < 0:
            raise InputError("--workers", repr(count), "0 (one a core) or more")
        self.count = count or cores()
        self.bench = bench
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[BaseProcess] = set()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is None:
            return
        # After an error, or Ctrl-C, nobody needs the cells that are being computed, and they may take long. A process
        # that is ended while it sends its result leaves the pool waiting for the rest of it, hence the grace. Only the
        # pool waits for the processes: the system reports the end of each to one waiter.
        ending = threading.Timer(GRACE_S, self._end)
        if kind is not None:
            ending.start()
        self._pool.shutdown(wait=True, cancel_futures=True)
        ending.cancel()

    def _end(self) -> None:
        """End the processes of the pool, also those that it started after its first task."""
        for child in multiprocessing.active_children():
            if child not in self._others:
                child.terminate()

    def results(
        self, experiment: Experiment, tasks: Sequence[Task], places: Sequence[int]
    ) -> Iterator[tuple[int, Values]]:
        """(place, values) of the tasks at these places, as they finish.

        What runs on a GPU runs here: every process of its own would take its share of the GPU's memory.

        :param tasks: of the experiment, in its order
        :raises InputError: of a task
        :raises TrainingStopped: a process was killed
        """
        if self.count == 1:
            for place in places:
                yield place, alone(tasks[place])
            return
        here = deque(place for place in places if tasks[place].device != "cpu")
        elsewhere = deque(place for place in places if tasks[place].device == "cpu")
        running: dict[Future[Values], int] = {}
        try:
            pool = self._started() if elsewhere else None
            while here or elsewhere or running:
                while pool and elsewhere and len(running) < AHEAD * self.count:
                    place = elsewhere.popleft()
                    running[pool.submit(_compute, experiment, place)] = place
                if here:
                    place = here.popleft()
                    yield place, alone(tasks[place])
                finished, _ = wait(running, timeout=0.0 if here else None, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield running.pop(future), future.result()
        except BrokenProcessPool as error:
            raise TrainingStopped(
                "a worker process was ended from outside, for lack of memory perhaps; the same command with --resume, "
                "and fewer --workers, goes on"
            ) from error

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._others = set(multiprocessing.active_children())
            # Plain pickle: the one of multiprocessing would send weights through shared memory.
            content = pickle.dumps(_without_gpu(self.bench))
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.count, context, initializer=_start, initargs=(content,))
            with _interrupt_blocked():
                for _ in range(self.count):
                    self._pool.submit(int)
        return self._pool


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    """Processes started meanwhile never receive Ctrl-C, which a terminal sends to all: this process ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _without_gpu(bench: Bench) -> Bench:
    """The bench for processes that compute nothing of a contender on a GPU."""
    contenders = tuple(c if c.device == "cpu" else replace(c, imaging=_not_here) for c in bench.contenders)
    return replace(bench, contenders=contenders)


def _not_here(_snapshots: object, _noise_power: float) -> Any:
    raise RuntimeError("a contender on a GPU is imaged in the main process")


def alone(task: Task) -> Values:
    """In this process, with as many threads as a worker has."""
    with threadpool_limits(limits=1):
        return task.compute()


_state: dict[str, Any] = {}
"""What a worker process was given at its start; a process pool hands tasks nothing else."""


def _start(content: bytes) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    torch.set_num_threads(1)
    # The limits hold as long as the object does.
    _state.update(bench=pickle.loads(content), limits=threadpool_limits(limits=1), name="", tasks=())


def _end_with_parent() -> None:
    """A parent that was killed cannot end its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_sentinels([parent.sentinel])
        os._exit(1)


def _compute(experiment: Experiment, place: int) -> Values:
    if _state["name"] != experiment.name:
        _state.update(name=experiment.name, tasks=experiment.tasks(_state["bench"]))
    return dict(_state["tasks"][place].compute())
