"""The process that holds the connection to Ray: ``python -c``, started by :mod:`datafactory.run.cluster.engine`.

From its pipe it reads an address, or None for the cluster that this machine is a node of, or a Ray of this run's own.
It answers :data:`REACHED`, then :class:`Connected`; an exception in place of either, or later, says why not. After
:class:`Begin` it reads portions to be made, and sends a :class:`Look` several times a second. It ends with the process
that started it, or as the pipe is closed; Ray then ends what it had begun."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from datafactory.run.cluster.node import difference, look_around, make_portion, processor, surroundings, unlike
from datafactory.run.portions import Rows, new_file
from datafactory.run.shards import Portion
from shared.physics.errors import InputError
from shared.processes.pool import end_with_parent

PROBE_S = 120.0
"""Within this a node has to say what is installed on it; the first process of a node takes some seconds to start."""
LOOK_S = 0.3
"""How often the cluster is looked at."""
NODES_EVERY_S = 2.0
"""How often its nodes are counted."""
REACHED = "reached"
"""Ray is there."""
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DEDUP_LOGS": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # silences a warning about the default that will change
}
LONGEST_TEMPORARY = 38
"""Characters of a temporary folder below which Ray's sockets, 68 characters on, have paths that Linux takes."""


@dataclass(frozen=True)
class Connected:
    """The nodes have been asked what they are like.

    :param nodes: alive, that have a processor for tasks
    :param cores: that they have together
    :param notes: lines for the user
    """

    nodes: int
    cores: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Begin:
    """What all portions need.

    :param given: a pickled :class:`datafactory.run.cluster.node.Given`
    :param folder: of this machine, for the files of rows
    :param memory: of a process [bytes]
    """

    given: bytes
    folder: Path
    memory: int


@dataclass(frozen=True)
class Outcome:
    """What became of a portion that was handed out: one of the four is set.

    :param rows: it is made
    :param died: how the process that worked on it ended
    :param lost: its machine is gone
    :param error: what its task raised
    """

    portion: Portion
    rows: Rows | None = None
    died: str = ""
    lost: bool = False
    error: Exception | None = None


@dataclass(frozen=True)
class Look:
    """How the cluster stands.

    :param outcomes: since the last look
    :param places: portions that its nodes can work on at a time
    """

    outcomes: tuple[Outcome, ...]
    places: int


def main() -> None:
    """Serve the process that holds the other end of the pipe whose number is the last argument."""
    end_with_parent(os.getppid())
    pipe = Connection(int(sys.argv[-1]))
    os.environ |= QUIET
    if len(tempfile.gettempdir()) > LONGEST_TEMPORARY:
        os.environ.setdefault("RAY_TMPDIR", "/tmp")
    try:
        _connect(pipe.recv())
        pipe.send(REACHED)
        pipe.send(_connected())
        _serve(pipe)
    except EOFError:
        pass
    except Exception as error:
        pipe.send(error)
    finally:
        pipe.close()  # the command need not wait for what follows
        import ray

        ray.shutdown()


def _serve(pipe: Connection) -> None:
    """Until the pipe is closed, or the cluster is gone: the command notices that nobody holds the other end.

    :raises EOFError: the pipe is closed
    :raises OSError: rows cannot be written
    """
    from ray.exceptions import RayError

    with suppress(RayError, RuntimeError, ConnectionError):
        Driver(pipe).serve()


def _connect(address: str | None) -> None:
    """:raises InputError: Ray is of another version, or this machine is no node of the cluster"""
    import ray

    try:
        ray.init(address=address, include_dashboard=False, log_to_driver=False, logging_level=logging.CRITICAL)
    except (RuntimeError, ConnectionError, ValueError) as error:
        raise InputError("--address", str(error), "HOST:PORT of a cluster that this machine is a node of") from error


def _connected() -> Connected:
    import ray

    nodes = [node for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU", 0.0) >= 1.0]
    return Connected(len(nodes), sum(int(node["Resources"]["CPU"]) for node in nodes), _looked_at(nodes))


def _looked_at(nodes: list[dict[str, Any]]) -> tuple[str, ...]:
    """Ask every node what is installed on it; lines for the user.

    :raises InputError: a node that would make other bytes, or that does not answer
    """
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    ask = ray.remote(look_around)
    answers = {
        ask.options(
            num_cpus=0, max_retries=0, scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        ).remote(): f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']})"
        for node in nodes
    }
    ready, late = ray.wait(list(answers), num_returns=len(answers), timeout=PROBE_S)
    if late:
        raise InputError("--engine", f"node {answers[late[0]]} starts no process in {PROBE_S:.0f} s", "one that does")
    here, notes = surroundings(), []
    for answer in ready:
        try:
            there, kind = ray.get(answer)
        except (ray.exceptions.RayTaskError, ray.exceptions.RaySystemError) as error:
            said = str(error).strip().splitlines()[-1]
            fault = f"node {answers[answer]} cannot load datafactory: {said}"
            raise InputError("--engine", fault, "pip install 'sparseradar-datafactory[ray]' on every node") from error
        except ray.exceptions.RayError:
            continue  # it is gone, as it may be at any time; every process is asked again before its first portion
        if found := difference(here, there):
            raise unlike(answers[answer], found)
        if kind != processor():
            notes.append(
                f"node {answers[answer]} has another kind of processor, {kind} beside {processor()}: last digits may "
                "differ there"
            )
    return tuple(notes)


@dataclass
class _Running:
    """A portion that was handed to the cluster.

    :param counted, content: references of what :func:`datafactory.run.cluster.node.make_portion` returns
    """

    portion: Portion
    counted: Any
    content: Any


class Driver:
    """Portions on a cluster that this process is connected to.

    :param pipe: to the command
    :raises EOFError: the pipe is closed
    """

    def __init__(self, pipe: Connection) -> None:
        import ray

        self._pipe = pipe
        begin: Begin = pipe.recv()
        self._folder, self._memory = begin.folder, begin.memory
        self._given = ray.put(begin.given)
        # Ray itself tries nothing again: how often a portion was tried is counted in one place, by the command.
        self._make: Any = ray.remote(make_portion).options(
            num_returns=2, num_cpus=1, memory=begin.memory, max_retries=0
        )
        self._running: list[_Running] = []
        self._places = 0
        self._places_at = float("-inf")

    def serve(self) -> None:
        """Until the pipe is closed.

        :raises EOFError: it is closed
        """
        while True:
            while self._pipe.poll(0.0 if self._running else LOOK_S):
                self._submit(self._pipe.recv())
            outcomes = self._finished()
            self._pipe.send(Look(tuple(outcomes), self._places_now()))

    def _submit(self, portion: Portion) -> None:
        self._running.append(_Running(portion, *self._make.remote(portion, [self._given])))

    def _finished(self) -> list[Outcome]:
        import ray

        if not self._running:
            return []
        by_content = {task.content: task for task in self._running}
        ray.wait(list(by_content), timeout=LOOK_S)
        ready, _ = ray.wait(list(by_content), num_returns=len(by_content), timeout=0.0)
        done = [by_content[content] for content in ready]
        self._running = [task for task in self._running if task not in done]
        return [self._outcome(task) for task in done]

    def _outcome(self, task: _Running) -> Outcome:
        from ray import exceptions, get

        try:
            counted, content = get(task.counted), get(task.content)
        except exceptions.RayTaskError as error:
            return Outcome(task.portion, error=error.cause)
        except exceptions.OutOfMemoryError:
            return Outcome(task.portion, died="Ray ended its process because its node was short of memory")
        except exceptions.WorkerCrashedError:
            return Outcome(task.portion, died="its process ended")
        except (exceptions.NodeDiedError, exceptions.ObjectLostError):
            return Outcome(task.portion, lost=True)
        with new_file(self._folder, task.portion) as file:
            file.write_bytes(memoryview(content))
        return Outcome(task.portion, Rows(file, *counted))

    def _places_now(self) -> int:
        import ray

        if time.monotonic() > self._places_at + NODES_EVERY_S:
            self._places_at = time.monotonic()
            resources = [node["Resources"] for node in ray.nodes() if node["Alive"]]
            self._places = sum(
                int(min(there.get("CPU", 0.0), there.get("memory", 0.0) // self._memory)) for there in resources
            )
        return self._places
