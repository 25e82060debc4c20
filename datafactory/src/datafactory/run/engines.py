"""Where frames are made: in processes of this machine, or on a Ray cluster. The bytes do not depend on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Protocol

from datafactory.defaults import LOCAL, RAY
from datafactory.run.portions import PortionWork, Rows, make_ready
from datafactory.run.shards import Portion
from shared.physics.errors import InputError
from shared.processes.pool import Processes, ThisProcess, WorkerPool
from shared.processes.tasks import Pool


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
