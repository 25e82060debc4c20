"""Where shards are made: in processes of this machine, or on a Ray cluster. The bytes do not depend on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from datafactory.run.defaults import LOCAL, RAY
from datafactory.run.progress import workers_folder
from datafactory.run.shards import ShardPlan
from datafactory.run.workers import ShardResult, ShardWork
from shared.physics.errors import InputError
from shared.processes.pool import WorkerPool
from shared.processes.tasks import Pool


class Engine(Protocol):
    """Gives a run its pool."""

    @property
    def name(self) -> str:
        """One of :data:`datafactory.run.defaults.ENGINES`."""

    def processes_here(self, workers: int) -> int:
        """Processes of this machine that make shards at a time; this one makes the plan, and counts as one.

        :param workers: as :attr:`datafactory.run.pipeline.Execution.workers`
        """

    def pool(self, work: ShardWork, shards: int, workers: int) -> Pool[ShardPlan, ShardResult] | None:
        """A pool for so many shards; None where this process makes them: a script needs no guard then."""


@dataclass(frozen=True)
class Local:
    """Processes of this machine."""

    name: str = LOCAL

    def processes_here(self, workers: int) -> int:
        """All."""
        return workers

    def pool(self, work: ShardWork, shards: int, workers: int) -> Pool[ShardPlan, ShardResult] | None:
        """None for one worker, or one shard."""
        count = min(workers, shards)
        if count <= 1:
            return None
        return WorkerPool[ShardPlan, ShardResult](work, count, workers_folder(work.directory))


@contextmanager
def opened(name: str, address: str | None, announce: Callable[[str], None]) -> Iterator[Engine]:
    """An engine that is ready to work; its connection, where it has one, ends with the block.

    :param name: one of :data:`datafactory.run.defaults.ENGINES`
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
