"""Frames on a Ray cluster, as the command sees it: a pool like that of worker processes on this machine."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing.connection import Pipe
from types import TracebackType
from typing import Any

import cloudpickle

from datafactory.defaults import RAY
from datafactory.run.cluster.driver import PROBE_S, REACHED, Begin, Connected, Look
from datafactory.run.cluster.node import Given, surroundings_of
from datafactory.run.portions import Engine, PortionWork, Rows, RunFailed
from datafactory.run.shards import Portion
from shared.dataset.locations import absolute
from shared.physics.errors import InputError
from shared.processes.pool import AHEAD, Attempts, Finished, without_interrupts
from shared.processes.telling import Announce

ANSWER_S = 5.0
"""Within this something at an address accepts a connection."""
CONNECT_S = 60.0
"""Within this a cluster answers, or Ray is started on this machine: 3 to 10 s, more where the machine is busy. Ray
itself waits for ever."""
END_S = 15.0
"""Within this the driver lets go of its cluster; a Ray of the run's own takes 3 s to end."""
EXPECTED = "HOST:PORT of a cluster that this machine is a node of"
DRIVER = "from datafactory.run.cluster.driver import main; main()"
GONE = (
    "--engine ray: the connection to the cluster is lost: its head, or the Ray of this machine, has ended; the same "
    "command with --resume goes on"
)


@contextmanager
def connected(address: str | None, announce: Announce) -> Iterator[RayEngine]:
    """A cluster that is ready to work, until the end of the block.

    :param address, announce: see :func:`datafactory.run.portions.opened`
    :raises InputError: Ray is not installed; no cluster, or one that would make other bytes
    """
    if find_spec("ray") is None:
        raise InputError("--engine", "ray is not installed", "pip install 'sparseradar-datafactory[ray]'")
    if address is not None:
        _require_answer(address)
    driver = _Driver()
    try:
        driver.send(address)
        reached = driver.receive(CONNECT_S, address)
        about = driver.receive(PROBE_S + CONNECT_S, address)
        assert reached == REACHED
        assert isinstance(about, Connected)
        for note in about.notes:
            announce(note)
        announce(f"Ray: {about.nodes} {'node' if about.nodes == 1 else 'nodes'} to work on")
        yield RayEngine(driver, about.cores, announce)
    finally:
        driver.end()


class _Driver:
    """The process that holds the connection to Ray, see :mod:`datafactory.run.cluster.driver`."""

    def __init__(self) -> None:
        self._pipe, theirs = Pipe()
        with without_interrupts(), theirs:
            # What Ray prints is in the logs of its session, in Ray's temporary folder.
            self._process = subprocess.Popen(
                [sys.executable, "-c", DRIVER, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

    def send(self, message: object) -> None:
        """:raises RunFailed: it has ended"""
        try:
            self._pipe.send(message)
        except OSError as error:
            raise RunFailed(GONE) from error

    def receive(self, timeout_s: float, address: str | None) -> Any:
        """The next message.

        :raises InputError: none within this time [s], or what was wrong
        """
        where = "Ray on this machine" if address is None else repr(address)
        if not self._pipe.poll(timeout_s):
            problem = f"{where} does not answer within {timeout_s:.0f} s"
            raise InputError("--address", problem, EXPECTED)
        try:
            return _checked(self._pipe.recv())
        except (EOFError, OSError):
            raise InputError("--address", f"{where} cannot be joined", EXPECTED) from None

    def looks(self, timeout_s: float) -> Iterator[Look]:
        """What came within this time [s].

        :raises RunFailed: it has ended
        :raises OSError: it cannot write rows
        """
        while self._pipe.poll(timeout_s):
            try:
                message = self._pipe.recv()
            except (EOFError, OSError) as error:
                raise RunFailed(GONE) from error
            yield _checked(message)
            timeout_s = 0.0

    def end(self) -> None:
        """Let it end what it had begun; it may have ended before."""
        self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
            return
        self._process.kill()  # Ray ends the tasks of a driver that is gone
        self._process.wait()


def _checked(message: Any) -> Any:
    """What the driver says; what went wrong there is raised here."""
    if isinstance(message, Exception):
        raise message
    return message


def _require_answer(address: str) -> None:
    """Refuse at once what Ray would try for ever.

    :raises InputError: no address, or nothing there
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise InputError("--address", repr(address), EXPECTED)
    try:
        socket.create_connection((host, int(port)), ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise InputError("--address", f"{address!r}: {getattr(error, 'strerror', None) or error}", EXPECTED) from error


def _as_seen_from_anywhere(work: PortionWork) -> PortionWork:
    """The folder that a command runs in is not that of a node's processes."""
    deal = work.job.deal
    stored = tuple(replace(row, shard=absolute(row.shard)) for row in deal.stored)
    return replace(work, job=replace(work.job, deal=replace(deal, stored=stored)))


class RayEngine(Engine):
    """A cluster that this process is connected to, for one run.

    :param driver: the connection
    :param cores: of its nodes
    :param announce: takes lines for the user
    """

    name = RAY

    def __init__(self, driver: _Driver, cores: int, announce: Announce) -> None:
        self._driver, self._cores, self._announce = driver, cores, announce

    @contextmanager
    def ahead(self, count: int, device: str | None) -> Iterator[None]:
        """No process of this machine is needed."""
        yield

    def at_a_time(self, workers: int) -> int:
        """As many as were asked for, or the nodes have cores now."""
        return workers or max(self._cores, 1)

    def pool(self, work: PortionWork, portions: int, workers: int) -> RayPool:
        """Processes of the cluster's nodes."""
        return RayPool(work, work.job.load.worker_bytes, workers, self._driver, self._announce)


class RayPool:
    """A :class:`shared.processes.pool.Pool` of the cluster's processes.

    :param memory: that a process takes [bytes]
    :param workers: portions at work at a time; 0 for as many as the nodes have cores and memory for
    """

    def __init__(self, work: PortionWork, memory: float, workers: int, driver: _Driver, announce: Announce) -> None:
        self._work, self._memory, self._workers = work, int(memory), workers
        self._driver, self._announce = driver, announce
        self._attempts = Attempts[Portion, Rows]()
        self._running = 0
        self._places: int | None = None
        self._waiting_told = False

    def __enter__(self) -> RayPool:
        given = cloudpickle.dumps(Given(_as_seen_from_anywhere(self._work), surroundings_of(self._work)))
        self._driver.send(Begin(given, self._work.folder.absolute(), self._memory))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._driver.end()

    @property
    def busy(self) -> bool:
        """Whether any portion is not finished."""
        return self._running > 0

    @property
    def has_room(self) -> bool:
        """Whether another portion may be handed out: some wait, so that Ray's autoscaler sees that nodes are wanted."""
        return self._running < (self._workers or AHEAD * max(self._places or 0, 1))

    def submit(self, item: Portion) -> None:
        """Hand a portion to the cluster."""
        self._driver.send(item)
        self._running += 1

    def finished(self, timeout_s: float) -> Iterator[Finished[Portion, Rows]]:
        """What has finished within this time [s]; portions whose process or node was lost are handed out again.

        :raises Exception: what the making of a portion raised
        :raises RunFailed: the cluster is gone
        """
        for look in self._driver.looks(timeout_s):
            self._places = look.places
            for outcome in look.outcomes:
                self._running -= 1
                if outcome.error is not None:
                    raise outcome.error
                portion = outcome.portion
                if outcome.rows is not None:
                    yield Finished(portion, outcome.rows)
                    continue
                failure = self._attempts.lost(portion) if outcome.lost else self._attempts.died(portion, outcome.died)
                if failure is None:
                    self.submit(portion)
                else:
                    yield failure
        self._tell_of_waiting()

    def _tell_of_waiting(self) -> None:
        waiting = self._places == 0
        if waiting and not self._waiting_told:
            self._announce(
                f"no node of the cluster has a core and {self._memory / 1e9:.1f} GB of memory for tasks: waiting"
            )
        self._waiting_told = waiting
