"""Where frames are made: in processes of this machine, or on a Ray cluster. The bytes do not depend on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from datafactory.run.portions import PortionWork, Rows
from datafactory.run.shards import Portion
from shared.physics.errors import InputError
from shared.processes.pool import ThisProcess, WorkerPool
from shared.processes.tasks import Pool

LOCAL, RAY = "local", "ray"
ENGINES = (LOCAL, RAY)


class Engine(Protocol):
    """Gives a run its pool."""

    @property
    def name(self) -> str:
        """One of :data:`ENGINES`."""

    def processes_here(self, workers: int) -> int:
        """Processes of this machine that make frames at a time; this one makes the plan, and counts as one.

        :param workers: as :attr:`datafactory.run.pipeline.Execution.workers`
        """

    def at_a_time(self, workers: int) -> int:
        """Processes that make frames at a time, wherever they are."""

    def pool(self, work: PortionWork, portions: int, workers: int) -> Pool[Portion, Rows]:
        """A pool for so many portions."""


@dataclass(frozen=True)
class Local:
    """Processes of this machine."""

    name: str = LOCAL

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
        return WorkerPool[Portion, Rows](work, count, work.folder / "pool")


@contextmanager
def opened(name: str, address: str | None, announce: Callable[[str], None]) -> Iterator[Engine]:
    """An engine that is ready to work; its connection, where it has one, ends with the block.

    :param name: one of :data:`ENGINES`
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
