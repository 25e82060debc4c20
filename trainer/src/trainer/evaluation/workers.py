"""Cells of an experiment, in this process or in several (:mod:`shared.processes.pool`).

Every cell is computed with one thread, here and there, so that its numbers do not depend on how many are computed at a
time. A worker is given the bench once and after that only which task of which experiment is next: it lists an
experiment's tasks for itself, and tasks that follow each other find what they share (a frame, a simulated scene)
already made.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

from shared.processes.machine import may_start_processes, usable_cores
from shared.processes.pool import WorkerPool
from trainer.errors import Stopped
from trainer.evaluation.experiments.bench import Bench, Experiment, Task
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.store import Values
from trainer.run.answers import NetworkAnswer

POLL_S = 1.0
"""Longest wait for a cell before the next look."""

Item = tuple[Experiment, int]
"""An experiment, and the place of a task among those that it lists; it is pickled in a few bytes."""


class CellWork:
    """What every worker is given once."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._listed: tuple[str, Sequence[Task]] = ("", ())

    def begin(self) -> None:
        """One thread from here on."""
        torch.set_num_threads(1)
        self._limits = threadpool_limits(limits=1)  # they hold as long as the object does

    def __call__(self, item: Item) -> Values:
        """Compute one cell."""
        experiment, place = item
        if self._listed[0] != experiment.name:
            self._listed = experiment.name, experiment.tasks(self._bench)
        return dict(self._listed[1][place].compute())


class Workers(ExitStack):
    """Computes cells; a context, which ends its processes when it is left, whatever for.

    :param bench: what the cells are of; handed over as the first cell is asked for
    :param count: processes; 1 computes here, 0 takes one for each core, or 1 where this process may start no others
    :param folder: for the files that are handed over; it is made, and removed at the end
    """

    def __init__(self, bench: Bench, count: int, folder: Path) -> None:
        super().__init__()
        self.count = count or (usable_cores() if may_start_processes() else 1)
        self.bench = bench
        self._folder = folder
        self._pool: WorkerPool[Item, Values] | None = None

    def results(
        self, experiment: Experiment, tasks: Sequence[Task], places: Sequence[int]
    ) -> Iterator[tuple[int, Values]]:
        """(place, values) of the tasks at these places, as they finish.

        What runs on a GPU runs here: every process of its own would take its share of the GPU's memory.

        :param tasks: of the experiment, in its order
        :raises InputError: of a task
        :raises Stopped: three processes died of a task
        """
        ours = {place for place in places if self.count == 1 or tasks[place].device != "cpu"}
        here = deque(place for place in places if place in ours)
        elsewhere = deque(place for place in places if place not in ours)
        running = set(elsewhere)
        pool = self._started() if elsewhere else None
        while here or running:
            while pool and elsewhere and pool.has_room:
                pool.submit((experiment, elsewhere.popleft()))
            if here:
                place = here.popleft()
                with threadpool_limits(limits=1):  # as many threads as a worker has
                    values = tasks[place].compute()
                yield place, values
            for finished in pool.finished(0.0 if here else POLL_S) if pool else ():
                asked_by, place = finished.item
                if asked_by is not experiment:
                    continue  # of a caller that went away
                if finished.result is None:
                    raise Stopped(_failure_line(experiment, tasks[place], finished.failure))
                running.remove(place)
                yield place, finished.result

    def _started(self) -> WorkerPool[Item, Values]:
        if self._pool is None:
            work = CellWork(_without_gpu(self.bench))
            self._pool = self.enter_context(WorkerPool[Item, Values](work, self.count, self._folder))
        return self._pool


def _failure_line(experiment: Experiment, task: Task, how: str) -> str:
    cell = " ".join(filter(None, (experiment.name, *task.key)))
    return f"{cell}: {how}, perhaps for lack of memory; the same command with --resume, and fewer --workers, goes on"


def _without_gpu(bench: Bench) -> Bench:
    """The bench for processes that compute nothing of a contender on a GPU: its network is a copy off it."""

    def moved(contender: Contender) -> Contender:
        answer = contender.answer
        if contender.device == "cpu" or not isinstance(answer, NetworkAnswer):
            return contender
        return replace(contender, answer=replace(answer, imager=deepcopy(answer.imager).cpu()))

    return replace(bench, contenders=tuple(map(moved, bench.contenders)))
