"""Tasks in worker processes of which any may die at any moment.

Each worker is a loky executor of one process. A death breaks that executor and no other: its task is tried again in a
fresh process, and the task that a process died of is known. Workers share no lock and no pipe, which a process that is
killed could leave locked or half written. What all tasks need is handed over by file, and so are results: a pipe takes
a long message in parts, and whoever waits for the rest of it waits for ever.

A worker ends by itself when the process that started it is gone. Ctrl-C reaches that process alone.
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from loky import ProcessPoolExecutor, process_executor
from loky.process_executor import BrokenProcessPool

from shared.physics.errors import InputError
from shared.processes.machine import may_start_processes

AHEAD = 2
"""Tasks handed to each worker: one at work, one to go on with."""
PARENT_CHECK_S = 0.5
"""How often a worker looks whether the process that started it is still there."""

WORK = "work.pickle"

ATTEMPTS = 3
"""Processes that may die of one task before it counts as failed."""
LOSSES = 10
"""Machines that may be lost with one task before it counts as failed. A machine holds many tasks, and is seldom lost by
the fault of one; a task whose machine is always lost is to blame all the same."""

Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")
Item_contra = TypeVar("Item_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Item_contra, Result_co]):
    """What every worker is given once; it can be pickled."""

    def begin(self) -> None:
        """Make the process ready; called once in each."""

    def __call__(self, item: Item_contra, /) -> Result_co:
        """Do one task."""


@dataclass(frozen=True)
class Finished(Generic[Item, Result]):
    """A task that is done, or that failed.

    :param result: None where it failed
    :param failure: how often and how its processes ended, in words; empty where it is done
    """

    item: Item
    result: Result | None
    failure: str = ""


class Pool(Protocol[Item, Result]):
    """Processes that work on tasks; a context, which ends what it started when it is left, whatever for."""

    def __enter__(self) -> Pool[Item, Result]: ...

    def __exit__(self, *error: Any) -> None: ...

    @property
    def busy(self) -> bool:
        """Whether any task is not finished."""

    @property
    def has_room(self) -> bool:
        """Whether another task may be handed out."""

    def submit(self, item: Item) -> None:
        """Hand out a task."""

    def finished(self, timeout_s: float) -> Iterator[Finished[Item, Result]]:
        """What has finished within this time [s]; tasks of processes that died are handed out again.

        :raises Exception: what a task raised
        """


class Attempts(Generic[Item, Result]):
    """How often a task was begun in vain, and whether it is tried again."""

    def __init__(self) -> None:
        self._deaths: Counter[Item] = Counter()
        self._losses: Counter[Item] = Counter()

    def died(self, item: Item, how: str) -> Finished[Item, Result] | None:
        """A process died of a task; None where it is to be tried again.

        :param how: the process ended, in words
        """
        self._deaths[item] += 1
        if self._deaths[item] < ATTEMPTS:
            return None
        return Finished(item, None, f"three worker processes died of it, {how}")

    def lost(self, item: Item) -> Finished[Item, Result] | None:
        """A machine was lost with a task; None where it is to be tried again."""
        self._losses[item] += 1
        if self._losses[item] < LOSSES:
            return None
        return Finished(item, None, f"{LOSSES} machines were lost while they worked on it")


@dataclass
class _Worker(Generic[Item]):
    """One process, and what was handed to it in order."""

    executor: ProcessPoolExecutor
    running: deque[tuple[Item, Path, Future[None]]] = field(default_factory=deque)


class ThisProcess(Pool[Item, Result]):
    """A pool without processes: a task is done here when it is asked for.

    :param work: that is done
    """

    def __init__(self, work: Work[Item, Result]) -> None:
        self._work = work
        self._waiting: list[Item] = []

    def __enter__(self) -> ThisProcess[Item, Result]:
        self._work.begin()
        return self

    def __exit__(self, *error: object) -> None:
        pass

    @property
    def busy(self) -> bool:
        return bool(self._waiting)

    @property
    def has_room(self) -> bool:
        return not self._waiting

    def submit(self, item: Item) -> None:
        self._waiting.append(item)

    def finished(self, timeout_s: float) -> Iterator[Finished[Item, Result]]:
        while self._waiting:
            item = self._waiting.pop()
            yield Finished(item, self._work(item))


def require_processes() -> None:
    """:raises InputError: in a daemonic process, which ends without a thought for those that it started"""
    if not may_start_processes():
        where = "a daemonic process (of multiprocessing.Pool, say), which may start no others"
        raise InputError("--workers", f"more than 1 in {where}", "1, which 0 is there")


class Processes:
    """Processes to be, which may be started before it is known what they will work on. A context that ends those that
    no pool took.

    :param ready: what each begins with, imports say; it can be pickled. Where it fails the work will say so
    """

    def __init__(self, ready: Callable[[], object] = int) -> None:
        self._ready = ready
        self._started: list[ProcessPoolExecutor] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *error: object) -> None:
        for executor in self._started:
            executor.shutdown(wait=True, kill_workers=True)

    def start(self, count: int) -> None:
        """Start so many; all get ready side by side.

        :raises InputError: any, where this process may start none
        """
        if count:
            require_processes()
        for _ in range(count):
            with without_interrupts():
                executor = ProcessPoolExecutor(1, initializer=_begin, initargs=(self._ready, os.getpid()))
                executor.submit(int)  # starts the process now
            self._started.append(executor)

    def one(self) -> ProcessPoolExecutor:
        """One for a pool, which ends it."""
        if not self._started:
            self.start(1)
        return self._started.pop(0)


class WorkerPool(Pool[Item, Result]):
    """A context that ends its processes when it is left, whatever for.

    :param work: what the workers do; its tasks can be pickled and hashed
    :param count: workers
    :param folder: for the files that are handed over; it is the pool's own, made, and removed at the end
    :param processes: where they come from
    """

    def __init__(self, work: Work[Item, Result], count: int, folder: Path, processes: Processes | None = None) -> None:
        self._work, self._count, self._folder = work, count, folder
        self._processes = processes or Processes()
        self._workers: list[_Worker[Item]] = []
        self._attempts = Attempts[Item, Result]()
        self._files = 0

    def __enter__(self) -> WorkerPool[Item, Result]:
        require_processes()
        shutil.rmtree(self._folder, ignore_errors=True)  # of a run that was killed
        self._folder.mkdir(parents=True, mode=0o700)
        (self._folder / WORK).write_bytes(pickle.dumps(self._work))
        self._workers = [_Worker(self._processes.one()) for _ in range(self._count)]
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.executor.shutdown(wait=True, kill_workers=True)
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def busy(self) -> bool:
        return any(worker.running for worker in self._workers)

    @property
    def has_room(self) -> bool:
        return any(len(worker.running) < AHEAD for worker in self._workers)

    def submit(self, item: Item) -> None:
        self._hand(min(self._workers, key=lambda worker: len(worker.running)), item)

    def finished(self, timeout_s: float) -> Iterator[Finished[Item, Result]]:
        wait([worker.running[0][2] for worker in self._workers if worker.running], timeout_s, FIRST_COMPLETED)
        for place in range(self._count):
            while (worker := self._workers[place]).running and worker.running[0][2].done():
                item, answer, future = worker.running.popleft()
                error = future.exception()
                if isinstance(error, BrokenProcessPool):
                    self._replace(place)
                    if (failure := self._attempts.died(item, _how(error))) is not None:
                        yield failure
                    else:
                        self.submit(item)
                    continue
                future.result()
                result: Result = pickle.loads(answer.read_bytes())
                answer.unlink()
                yield Finished(item, result)

    def _replace(self, place: int) -> None:
        """A fresh process in the place of one that died; what that had not begun goes on there."""
        dead = self._workers[place]
        dead.executor.shutdown(wait=True, kill_workers=True)
        fresh = self._workers[place] = _Worker(self._processes.one())
        for item, _, _ in dead.running:
            self._hand(fresh, item)

    def _hand(self, worker: _Worker[Item], item: Item) -> None:
        self._files += 1
        answer = self._folder / f"result-{self._files}"
        try:
            with without_interrupts():
                future = worker.executor.submit(_do, self._folder / WORK, item, answer)
        except BrokenProcessPool as error:  # it died while it had nothing to do
            future = Future()
            future.set_exception(error)
        worker.running.append((item, answer, future))


def _how(error: BaseException) -> str:
    codes = [part for part in str(error).replace("}", "{").split("{") if "SIG" in part or "EXIT" in part]
    return f"its process ended by {codes[0]}" if codes else "its process ended"


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes started meanwhile never see Ctrl-C, which a terminal sends to all: this one ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start, with the first process, would let Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(ready: Callable[[], object], parent: int) -> None:
    end_with_parent(parent)
    # loky would end a worker that grew by 300 MB since its first task, which a larger scene does.
    process_executor._USE_PSUTIL = False
    with suppress(Exception):
        ready()


def end_with_parent(parent: int) -> None:
    """End this process when the one that started it is gone: a process that was killed cannot end its workers."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _do(work_file: Path, item: Any, answer: Path) -> None:
    answer.write_bytes(pickle.dumps(_begun(work_file)(item)))


@lru_cache(maxsize=1)  # a process works for one pool
def _begun(work_file: Path) -> Work[Any, Any]:
    work: Work[Any, Any] = pickle.loads(work_file.read_bytes())
    work.begin()
    return work
